"""
The teleoperation loop (scheme TMIG, ledger read-out, cancelling controller) in plain NumPy:
three-vectors, one sample a call.
"""

from collections import deque
from math import exp, floor, sqrt

import numpy as np


class PlainLoop:
    """
    A loop that is stepped from outside.

    Parameters
    ----------
    data : dict of str to numpy.ndarray
        settings, hand, auto (the numbers of the package's loop, by their names in `names_*`), phi,
        gamma, and the inputs.
    """

    def __init__(self, data):
        for kind in ("settings", "hand", "auto"):
            values = dict(zip(data[f"names_{kind}"].tolist(), data[kind].tolist(), strict=True))
            setattr(self, kind, values)
        self.phi, self.gamma = data["phi"], data["gamma"]
        self.inputs = {
            name: data[name]
            for name in ("reference", "moving", "detected", "delays", "motor", "pushed")
        }
        self.restart()

    def restart(self):
        """Go back to the first sample."""
        s = self.settings
        self.x, self.v, self.wish, self.integral = (np.zeros(3) for _ in range(4))
        self.state = np.zeros((3, 3))
        self.state[:, 0] = self.inputs["reference"][0]
        self.seen = []
        self.left = []
        self.right = []
        self.books = [[0, 0.0, -1.0], [0, 0.0, -1.0]]
        self.trust = [0.5, 0.5]
        self.good = deque(maxlen=int(s["window"]))
        self.sums = [0.0, 0.0]
        self.work = self.lost = self.channel = self.robot = 0.0

    def read(self, sent, where, book):
        """
        Return the newest wave, no larger than the book allows.

        Parameters
        ----------
        sent : list of numpy.ndarray
            Waves so far.
        where : float
            Sample that is read now.
        book : list
            Next sample to book, energy held, latest sample read; changed.
        """
        period, first = self.settings["sample_time"], floor(where)
        while book[0] <= first:
            wave = sent[book[0]]
            book[1] += period * float(wave @ wave)
            book[0] += 1
        advance = min(max(where - book[2], 0.0), 1.0)
        book[2] = max(book[2], where)
        wave = sent[first] if first >= 0 else np.zeros(3)
        energy = period * float(wave @ wave)
        if energy > 0.0:
            # beyond one packet, what is left from skipped samples is spent at once
            part = min(max(advance, (book[1] - energy) / energy), 1.0)
            wave = sqrt(min(part, book[1] / energy)) * wave
        book[1] = max(book[1] - period * float(wave @ wave), 0.0)
        return wave

    def step(self, k):
        """
        Do sample k and return what the package logs of it, shape (52,).

        Parameters
        ----------
        k : int
            The sample; they must come in turn.
        """
        s = self.settings
        hand = self.hand
        auto = self.auto
        given = self.inputs
        period = s["sample_time"]
        b = s["b"]
        weight = s["weight"]
        gamma = s["force_scaling"]
        reference = given["reference"][k]
        position = self.state[:, 0].copy()
        velocity = self.state[:, 1].copy()
        error = reference - position
        self.seen.append(error)
        ideal = given["moving"][k] + error
        steered, late = np.zeros(3), k - int(auto["delay"])
        if late >= 1 and given["detected"][late]:
            rate = (
                (self.seen[late] - self.seen[late - 1]) / period
                if given["detected"][late - 1]
                else np.zeros(3)
            )
            wanted = auto["proportional"] * self.seen[late] + auto["derivative"] * rate
            summed = self.integral + period * self.seen[late]
            free = np.abs(wanted + auto["integral"] * summed) < auto["reach"]
            self.integral = np.where(free, summed, self.integral)
            steered = np.clip(
                wanted + auto["integral"] * self.integral, -auto["reach"], auto["reach"]
            )
        alpha, beta = (
            s[f"{name}.high"]
            - (s[f"{name}.high"] - s[f"{name}.low"]) / (1.0 + exp(-s["steepness"] * (trust - 0.5)))
            for name, trust in zip(("alpha", "beta"), self.trust, strict=True)
        )
        view, wanted = k - int(hand["delay"]), np.zeros(3)
        if view >= 1:
            rate = (self.seen[view] - self.seen[view - 1]) / period
            wanted = np.clip(
                hand["proportional"] * self.seen[view] + hand["derivative"] * rate,
                -hand["reach"],
                hand["reach"],
            )
        self.wish = hand["decay"] * self.wish + (1.0 - hand["decay"]) * wanted
        stiff, damp = s["stiffness"] + hand["stiffness"], s["damping"] + hand["damping"]
        force = stiff * self.wish / weight + given["pushed"][k]
        force = force + hand["noise"] * given["motor"][k] * (1.0 + np.abs(self.wish))
        arrived_right = self.read(self.left, k - given["delays"][0, k], self.books[0])
        arrived_left = self.read(self.right, k - given["delays"][1, k], self.books[1])
        # the device and its port: implicit midpoint, the feedback solved with it
        back = sqrt(2.0 * b / s["beta.high"]) * arrived_left
        inertia = 2.0 * s["mass"] / period
        tip = 1.0 + 0.5 * period * weight
        right = (
            inertia * self.v - stiff * self.x + force - gamma * beta * (b * weight * self.x + back)
        )
        middle = right / (inertia + damp + 0.5 * period * stiff + gamma * beta * b * tip)
        halfway = self.x + 0.5 * period * middle
        out = middle + weight * halfway
        felt = beta * (b * out + back)
        # the robot's port and its passivity controller
        spring = -s["guidance"] * error
        moved = alpha * (sqrt(2.0 * b / s["alpha.high"]) * arrived_right - spring) / b
        power = float(moved @ spring)
        square = float(moved @ moved)
        shrink = 1.0
        if self.robot <= 0.0 and power < 0.0 and square > 0.0:
            gain = square * b / alpha
            shrink = 1.0 - (-power / gain) if power + gain > 0.0 else 0.0
            moved = shrink * moved
        load = (
            spring
            if shrink == 1.0
            else sqrt(2.0 * b / s["alpha.high"]) * arrived_right - b * moved / alpha
        )
        self.left.append(sqrt(s["beta.low"] / (2.0 * b)) * (felt / beta + b * out))
        self.right.append(sqrt(s["alpha.low"] / (2.0 * b)) * (load - b * moved / alpha))
        pressed = force - hand["stiffness"] * halfway - hand["damping"] * middle
        self.work += period * float(out @ pressed) / gamma
        self.channel += period * float(out @ felt - moved @ load)
        self.robot += period * float(moved @ load)
        spare = s["damping"] - s["mass"] * weight
        self.lost += (
            period
            / gamma
            * float(spare * (middle @ middle) + weight * s["stiffness"] * (halfway @ halfway))
        )
        asked = moved / alpha
        before = self.x, self.v
        self.x, self.v = self.x + period * middle, 2.0 * middle - self.v
        tilt = self.v + weight * self.x
        inner = s["stiffness"] + weight * s["damping"] - weight**2 * s["mass"]
        stored = 0.5 * float(s["mass"] * (tilt @ tilt) + inner * (self.x @ self.x)) / gamma
        command = moved + (1.0 - alpha) * steered
        self.state = np.einsum("ijk,ik->ij", self.phi, self.state) + self.gamma * command[:, None]
        size = float(np.abs(error).sum())
        now = [
            max(1.0 - float(np.abs(mine - ideal).sum()) / s["command_range"], 0.0)
            * max(1.0 - share * size / s["error_range"], 0.0)
            for mine, share in ((steered, 1.0 - alpha), (asked, alpha))
        ]
        if len(self.good) == self.good.maxlen:
            self.sums = [total - old for total, old in zip(self.sums, self.good[0], strict=True)]
        self.good.append(now)
        self.sums = [total + new for total, new in zip(self.sums, now, strict=True)]
        performance = [max(total / len(self.good), 0.0) for total in self.sums]
        scales = [alpha, beta, *performance, *self.trust, sqrt(float(error @ error)), shrink]
        energies = [self.work, stored, self.lost, self.channel, self.robot]
        signals = (
            reference,
            position,
            velocity,
            *before,
            out,
            pressed,
            felt,
            moved,
            load,
            asked,
            steered,
            ideal,
        )
        row = np.concatenate([*signals, scales, energies])
        for i, end in enumerate(("hr", "rh")):
            low, high = s[f"trust_{end}.p_min"], s[f"trust_{end}.p_max"]
            share = min(max((performance[i] - low) / (high - low), 0.0), 1.0)
            decay = s[f"trust_{end}.decay"]
            self.trust[i] = decay * self.trust[i] + (1.0 - decay) * s[f"trust_{end}.gain"] * share
        return row

    def run(self, count=None):
        """
        Run from the start and return the log, shape (N, 52).

        Parameters
        ----------
        count : int, optional
            Samples; all there are when not given.
        """
        self.restart()
        count = len(self.inputs["reference"]) if count is None else count
        log = np.empty((count, 52))
        for k in range(count):
            log[k] = self.step(k)
        return log
