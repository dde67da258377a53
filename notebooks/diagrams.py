"""
The block diagrams of the primers, in inches on a page of 6.5.

Blue is velocity, vermilion force, green a wave, grey a signal; dashes are decisions, and two arrows
with a band between them a port, whose product is power. Equation numbers stand below the words of
the block that they define.
"""

import re
from functools import partialmethod
from itertools import pairwise
from math import dist

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

INK, GREY, PALE, EDGE = "#1f2328", "#4a525b", "#5f6770", "#8a929b"
FACE, BAND = "#f4f6f8", "#e3ebf2"
SIZE, LINE = 9.0, 0.165  # points, inches
SIDES = {"n": (0, 1), "e": (1, 0), "s": (0, -1), "w": (-1, 0)}
PLACE = re.compile(r"(\w+)\.([nesw])([+-][\d.]+)?")  # robot.e, or robot.e+0.1 above its middle


class Diagram:
    """Blocks, and arrows between their sides, on a page of so many inches."""

    def __init__(self, height: float, width: float = 6.5):
        self.figure = Figure((width, height), layout="none")
        self.axis: Axes = self.figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(0, height))
        self.axis.set_axis_off()
        self.boxes: dict[str, tuple[float, float, float, float]] = {}

    def text(self, words, x, y, colour=INK, ha="left"):
        """Write words at a place."""
        look = {"ha": ha, "va": "center_baseline", "fontsize": SIZE, "zorder": 6}
        self.axis.text(x, y, words, color=colour, **look)

    def block(self, name, words, x, y, w=1.0, h=0.56):
        """Place a block round (x, y); what follows a bar in its words is pale."""
        self.boxes[name] = (x, y, w, h)
        corner, shape = (x - w / 2, y - h / 2), "round,pad=0,rounding_size=0.05"
        self.axis.add_patch(
            FancyBboxPatch(corner, w, h, shape, fc=FACE, ec=EDGE, zorder=3 if words else 1)
        )
        dark = words.partition("|")[0].count("\n") + 1
        lines = re.split(r"[\n|]", words)
        for i, line in enumerate(lines):
            above = LINE * ((len(lines) - 1) / 2 - i)
            self.text(line, x, y + above, INK if i < dark else PALE, "center")

    def circle(self, name, x, y, words="", signs=""):
        """Place a product, a sum with signs as in "+w -s", or a point on a wire."""
        radius, fill = (0.1, "white") if words or signs else (0.03, PALE)
        self.boxes[name] = (x, y, 2 * radius, 2 * radius)
        self.axis.add_patch(Circle((x, y), radius, fc=fill, ec=INK, zorder=5))
        self.text(words, x, y, ha="center")
        for sign, side in signs.replace("-", "−").split():
            dx, dy = SIDES[side]
            self.text(sign, x + 0.19 * dx + 0.1 * dy, y + 0.19 * dy - 0.1 * dx, ha="center")

    def frame(self, words, left, bottom, right, top):
        """Draw a dotted outline round what belongs together."""
        look = {"fill": False, "ec": EDGE, "ls": (0, (1, 2.2))}
        self.axis.add_patch(Rectangle((left, bottom), right - left, top - bottom, **look))
        self.text(words, left + 0.07, top - 0.13, PALE)

    def wire(self, *places, colour=GREY, dashes="-"):
        """Draw a line through places, blocks' sides or points, and return its level legs."""
        points = [self._point(places[0])]
        for place in places[1:]:
            (x0, y0), (x1, y1) = points[-1], self._point(place)
            down = isinstance(place, str) and PLACE.fullmatch(place)[2] in "ns"
            if x0 != x1 and y0 != y1:
                points.append((x1, y0) if down else (x0, y1))
            points.append((x1, y1))
        self.axis.plot(*zip(*points), color=colour, lw=1.3, ls=dashes, zorder=2)
        return list(pairwise(points))

    def signal(self, label, *places, colour=GREY, dashes="-", side=1, leg=None, at=0.5):
        """
        Draw an arrow through places.

        The label stands above or right of the longest leg, or the one of that number, at this
        fraction; with side −1 below or left of it.
        """
        legs = self.wire(*places, colour=colour, dashes=dashes)
        tip = {"arrowstyle": "-|>,head_width=.17", "color": colour, "lw": 0, "shrinkA": 0}
        tip |= {"shrinkB": 0, "mutation_scale": 15}
        self.axis.annotate("", *reversed(legs[-1]), arrowprops=tip, zorder=4)
        longest = max(legs, key=lambda ends: dist(*ends))
        (x0, y0), (x1, y1) = longest if leg is None else legs[leg]
        beside = (0.06 * side, 0, "left" if side > 0 else "right")
        dx, dy, ha = (0, 0.13 * side, "center") if y0 == y1 else beside
        self.text(label, x0 + at * (x1 - x0) + dx, y0 + at * (y1 - y0) + dy, colour, ha)

    velocity = partialmethod(signal, colour="#0067a3")
    force = partialmethod(signal, colour="#ad4500")
    wave = partialmethod(signal, colour="#00785a")
    decision = partialmethod(signal, dashes=(0, (3.2, 2)))

    def ports(self, *chain, half=0.13):
        """
        Draw power ports between blocks side by side.

        Between the names of two blocks stand what goes right and what comes back; an f is a force.
        """
        for left, there, back, right in zip(*(chain[i::3] for i in range(3)), chain[3::3]):
            (x0, y), (x1, _) = self._point(f"{left}.e"), self._point(f"{right}.w")
            self.axis.add_patch(Rectangle((x0, y - half), x1 - x0, 2 * half, color=BAND, lw=0))
            for label, start, end, side in (
                (there, f"{left}.e", f"{right}.w", 1),
                (back, f"{right}.w", f"{left}.e", -1),
            ):
                draw = self.force if "f" in label else self.velocity
                draw(label, f"{start}{side * half:+}", f"{end}{side * half:+}", side=side)

    def _point(self, place):
        if not isinstance(place, str):
            return place
        name, side, shift = PLACE.fullmatch(place).groups("0")
        (x, y, w, h), (dx, dy) = self.boxes[name], SIDES[side]
        x, y = x + dx * w / 2 + abs(dy) * float(shift), y + dy * h / 2 + abs(dx) * float(shift)
        return round(x, 6), round(y, 6)  # what should be level is level


def two_levels():
    """Figs. 1.1 and 2.1: an inner loop that drives, an outer one that says who should."""
    d = Diagram(3.4)
    d.frame("Outer loop: who drives?", 1.98, 2.06, 6.44, 3.32)
    d.frame("", 1.98, 0.4, 6.44, 1.94)
    d.text("Inner loop: driving", 5.7, 0.5, PALE, "right")
    d.block("human", "Operator|$r$ by (2.5)\n$P_h$ by (2.6)", 0.62, 1.7, 1.04, 2.6)
    d.block("rule", "Rule, $TSC_l$\nand $TSC_u$|(2.8)", 2.66, 2.56, 1.04, 0.74)
    d.block("tsc", "TSC =\n$a_T P_r - b_T P_h$|(2.1)", 4.2, 2.56, 1.22, 0.74)
    d.block("means", "Means over\n100 s|(2.4), (2.7)", 5.82, 2.56, 0.98, 0.74)
    d.block("auto", "Autonomous\ncontroller", 2.72, 0.72, 1.1)
    d.block("robot", "Robot", 5.0, 1.22, 0.84)
    d.circle("manual", 3.61, 1.4)
    d.circle("alone", 3.61, 1.04)
    d.circle("switch", 4.11, 1.22)
    d.circle("out", 5.82, 1.22)
    d.circle("seen", 5.82, 0.6)
    d.signal("command $u_h$", "human.e-0.3", "manual.w", at=0.55)
    d.signal("$u_a$", "auto.e", (3.45, 0.72), "alone.w", leg=1)
    d.axis.plot((3.61, 4.11), (1.4, 1.22), color=INK)
    d.signal("$u$", "switch.e", "robot.w", at=0.4)
    d.wire("robot.e", "out.w")
    d.signal("speed, $e$", "out.n", "means.s", side=-1)
    d.signal("deviation $e$", "out.s", "auto.e-0.12", at=0.45)
    d.signal("what the operator sees", "seen.s", (5.82, 0.12), "human.s", at=0.2)
    d.signal("$P_r$, $P_h$", "means.w", "tsc.e")
    d.signal("TSC", "tsc.w", "rule.e")
    d.decision("suggestion", "rule.w", "human.e+0.86", at=0.57)
    d.decision("mode $M$", "human.e-0.06", (3.86, 1.64), (3.86, 1.34), at=0.16)
    return d


def model_loop():
    """Chapter 2 as five equations: the mode acts on the load, and on what reaches the robot."""
    d = Diagram(2.06)
    d.block("rule", "Rule|(2.8)", 0.66, 1.3, 0.9)
    d.block("use", "Utilization|(2.5)", 2.06, 1.3, 0.98)
    d.block("hand", "Human\nperformance|(2.6)", 3.52, 1.3, 1.08, 0.72)
    d.block("robot", "Robot\nperformance|(2.3)", 5.8, 1.3, 1.1, 0.72)
    d.block("tsc", "$a_T P_r - b_T P_h$|(2.1)", 3.0, 0.4, 1.4)
    d.circle("times", 4.66, 1.3, "×")
    d.circle("m", 1.3, 1.3)
    d.circle("p", 4.3, 1.3)
    d.decision("$M$", "rule.e", "use.w", at=0.67)
    d.signal("$r$", "use.e", "hand.w")
    d.signal("$P_h$", "hand.e", "times.w", at=0.4)
    d.signal("$M P_h$", "times.e", "robot.w")
    said = "$M$ = 1 manual, $M$ = 0 autonomous"
    d.decision(said, "m.n", (1.3, 1.82), "times.n")
    d.signal("$P_h$", "p.s", "tsc.e+0.12", leg=0)
    d.signal("$P_r$", "robot.s", "tsc.e-0.12", at=0.4)
    d.signal("TSC", "tsc.w", "rule.s")
    return d


def teleoperation():
    """Figs. 3.1, 3.4, 3.5 and 3.8: a chain of ports, which trust reaches through two scales."""
    d = Diagram(4.3)
    d.frame("Channel: passive, Theorem 3", 3.91, 0.34, 6.44, 4.22)
    d.block("human", "Operator|assumed\npassive", 0.58, 3.46, 0.96, 0.9)
    d.block("device", "Haptic device|$r$-passive\n(3.8)–(3.11)", 2.3, 3.46, 1.3, 0.9)
    d.block("one", "Scattering 1|scale $\\beta$\n(3.12), (3.13)", 4.5, 3.46, 1.06, 0.9)
    words = "Delays\n$T_1(t)$, $T_2(t)$\nand gains\n$f_1$, $f_2$|(3.16)"
    d.block("delay", words, 5.92, 2.18, 0.88, 3.46)
    d.block("two", "Scattering 2|scale $\\alpha$\n(3.12), (3.13)", 4.5, 0.9, 1.06, 0.9)
    d.block("guard", "Passivity\ncontroller|Theorem 4\n(3.19)", 3.13, 0.9, 0.9, 0.9)
    d.block("robot", "Robot and\nguidance|(A.1)", 1.86, 0.9, 0.9, 0.9)
    d.block("world", "Environ-\nment|passive", 0.52, 0.9, 0.84, 0.9)
    d.ports("human", "$f_h$", "$r_m$", "device", "$r_m$", "$f_m$", "one")
    d.ports("world", "$f_e$", "$v$", "robot", "$f'_s$", "$r_s$", "guard", "$f_s$", "$r_s$", "two")
    for name, place, there, back in (("one", 1.28, "u_l", "v_l"), ("two", -1.28, "u_r", "v_r")):
        d.wave(f"${there}$", f"{name}.e+0.13", f"delay.w{place + 0.13:+}")
        d.wave(f"${back}$", f"delay.w{place - 0.13:+}", f"{name}.e-0.13", side=-1)
    d.block("means", "Performance\n$P_h$, $P_r$|(3.26), (3.27)", 0.66, 2.18, 1.1, 0.76)
    d.block("trust_h", "Trust in operator $T_{rh}$|(3.3), (3.5)", 2.7, 2.5, 1.78)
    d.block("trust_r", "Trust in robot $T_{hr}$|(3.2), (3.5)", 2.7, 1.86, 1.78)
    d.signal("$u_h$", "human.s+0.08", "means.n")
    d.signal("error $e$", "world.n", "means.s-0.14")
    d.signal("$P_h$", "means.e+0.18", "trust_h.w-0.14")
    d.signal("$P_r$", "means.e-0.18", "trust_r.w+0.14", side=-1)
    d.signal("$\\beta$", "trust_h.e", "one.s", leg=1)
    d.signal("$\\alpha$", "trust_r.e", "two.n", leg=1)
    d.signal("1 − $\\alpha$", "trust_r.s-0.84", "robot.n")
    return d


def haptic_device():
    """Figs. 3.6 and 3.11: the output is velocity + Λ position, and γ scales what the hand feels."""
    d = Diagram(3.3)
    d.frame("", 0.62, 0.2, 5.86, 3.2)
    d.block("device", "Device|(3.8)", 1.98, 1.48, 0.98, 0.6)
    d.block("local", "Local control|$-B\\dot x - Kx$", 1.98, 2.38, 1.14, 0.6)
    d.block("sum", "∫", 3.46, 2.48, 0.46, 0.42)
    d.block("weight", "$\\Lambda$", 4.36, 2.48, 0.46, 0.42)
    d.block("small", "$\\gamma$", 3.46, 0.58, 0.46, 0.42)
    d.circle("force", 1.0, 1.48, signs="+w +n -s")
    d.circle("out", 5.02, 1.48, signs="+w +n")
    d.circle("v", 2.98, 1.48)
    d.circle("w", 3.46, 1.48)
    d.circle("r", 5.5, 1.48)
    d.force("$f_h$", (0.06, 1.48), "force.w", at=0.3)
    d.signal("", "force.e", "device.w")
    d.signal("$\\dot x$", "device.e", "out.w", at=0.75)
    d.signal("$\\dot x$", "v.n", "local.e-0.1", leg=0)
    d.signal("", "w.n", "sum.s")
    d.signal("$x$", "sum.w", "local.e+0.1")
    d.signal("$x$", "sum.e", "weight.w")
    d.signal("$\\Lambda x$", "weight.e", "out.n", leg=1, at=0.4)
    d.signal("$f_{local}$", "local.w", "force.n", leg=1, at=0.42)
    d.velocity("$r_m$", "out.e", (6.44, 1.48), at=0.9)
    d.force("$f''_m$", (6.44, 0.58), "small.e", at=0.3)
    d.force("$f_m$ = $\\gamma f''_m$", "small.w", "force.s", leg=0)
    d.velocity("$r''_m$ = $r_m/\\gamma$, to the operator", "r.n", (0.06, 2.95))
    return d


def channel():
    """Fig. 3.7: scattering outside the delays, the scales outside the scattering."""
    d = Diagram(2.34)
    d.frame("", 0.42, 0.3, 6.1, 2.02)
    d.block("one", "Scattering|(3.13)", 1.98, 1.12, 0.84, 1.3)
    d.block("two", "Scattering|(3.13)", 4.7, 1.12, 0.84, 1.3)
    d.block("beta", "$\\beta(t)$", 0.92, 0.72, 0.5, 0.42)
    d.block("t1", "$T_1(t)$", 3.0, 1.52, 0.56, 0.42)
    d.block("f1", "$f_1$", 3.74, 1.52, 0.42, 0.42)
    d.block("f2", "$f_2$", 2.93, 0.72, 0.42, 0.42)
    d.block("t2", "$T_2(t)$", 3.67, 0.72, 0.56, 0.42)
    d.block("alpha", "$\\alpha(t)$", 5.72, 1.52, 0.5, 0.42)
    d.velocity("$r_m$", (0.06, 1.52), "one.w+0.4", at=0.11)
    d.force("$f'_m$", "one.w-0.4", "beta.e")
    d.force("$f_m$", "beta.w", (0.06, 0.72), at=0.75)
    d.wave("$u_l$", "one.e+0.4", "t1.w")
    d.wave("", "t1.e", "f1.w")
    d.wave("$v_r$", "f1.e", "two.w+0.4")
    d.wave("$u_r$", "two.w-0.4", "t2.e")
    d.wave("", "t2.w", "f2.e")
    d.wave("$v_l$", "f2.w", "one.e-0.4")
    d.velocity("$r'_s$", "two.e+0.4", "alpha.w")
    d.velocity("$r_s$", "alpha.e", (6.44, 1.52), at=0.64)
    d.force("$f_s$", (6.44, 0.72), "two.e-0.4", at=0.13)
    d.signal("trust $T_{hr}$", (5.72, 2.3), "alpha.n", at=0.24, side=-1)
    d.signal("trust $T_{rh}$", (0.92, 0.04), "beta.s", at=0.28)
    d.text("power in: $r_m^T f_m$", 0.42, 2.18, PALE)
    d.text("power out: $r_s^T f_s$", 6.1, 0.14, PALE, "right")
    return d


def robot_side():
    """Figs. 3.9 and 3.10: the observer and the controller guard the port, not the robot."""
    d = Diagram(2.94)
    d.frame("Passivity controller", 0.56, 0.36, 2.3, 2.3)
    d.block("z", "$z(t)$", 1.0, 1.24, 0.5, 0.42)
    d.block("po", "PO", 1.88, 1.24, 0.46, 0.42)
    d.block("low", "Velocity\nloop", 3.62, 1.78, 0.8, 0.6)
    d.block("robot", "Robot", 4.74, 1.78, 0.74, 0.6)
    d.block("world", "Environ-\nment", 6.0, 1.78, 0.8, 0.6)
    d.block("one", "1 − $\\alpha$", 2.72, 2.58, 0.6, 0.42)
    d.block("auto", "Autonomous\ncontroller", 3.9, 2.58, 1.06)
    d.block("guide", "Guiding force|$-k_{ffa}\\, e$", 3.62, 0.66, 1.1)
    d.circle("r", 1.0, 1.78)
    d.circle("r2", 1.88, 1.78)
    d.circle("f2", 1.88, 0.66)
    d.circle("f", 1.0, 0.66, signs="+n +e")
    d.circle("ref", 2.72, 1.78, signs="+w +n")
    d.velocity("$r_s$", (0.06, 1.78), "ref.w", at=0.09)
    d.velocity("", "r.s", "z.n")
    d.force("$z r_s$", "z.s", "f.n", side=-1)
    d.signal("", "r2.s", "po.n")
    d.signal("", "f2.n", "po.s")
    d.decision("on", "po.w", "z.e")
    d.force("$f'_s$", "guide.w", "f.e", at=0.25)
    d.force("$f_s$", "f.w", (0.06, 0.66), at=0.75)
    d.signal("$v_{ref}$", "ref.e", "low.w")
    d.signal("", "low.e", "robot.w")
    d.ports("robot", "$v$", "$f_e$", "world")
    d.signal("error $e$", "robot.n", "auto.e", leg=0, at=0.4)
    d.signal("error $e$", "robot.s", "guide.e", leg=0)
    d.signal("$A_c$", "auto.w", "one.e")
    d.signal("$T_{hr}$", (1.9, 2.58), "one.w", at=0.4)
    d.signal("", "one.s", "ref.n")
    return d


def team():
    """Figs. 4.1, 4.3 and 4.4: the same chain, whose far end moves from robot to robot."""
    d = Diagram(3.5)
    d.block("human", "Operator|(4.30)", 0.48, 1.14, 0.8, 0.9)
    d.block("device", "Haptic\ndevice|(4.6)", 1.6, 1.14, 0.7, 0.9)
    d.block("one", "Filter\n$F_1$|(4.16)", 2.6, 1.14, 0.58, 0.9)
    d.block("waves", "Switched\nchannel|Theorem 5", 3.66, 1.14, 0.84, 0.9)
    d.block("two", "Filter\n$F_2$|(4.16)", 4.73, 1.14, 0.58, 0.9)
    d.block("team", "", 5.9, 1.14, 1.02, 1.7)
    d.text("Team (4.19)", 5.9, 1.86, PALE, "center")
    d.block("leader", "$i_k$", 5.64, 1.14, 0.3, 0.3)
    d.block("first", "1", 6.2, 1.52, 0.3, 0.3)
    d.block("last", "$N$", 6.2, 0.76, 0.3, 0.3)
    d.wire("leader.n", (5.64, 1.52), "first.w")
    d.wire("leader.s", (5.64, 0.76), "last.w")
    d.wire("first.s", "last.n")
    d.text("$i_k$: the leader", 5.9, 0.42, PALE, "center")
    hand = "human", "$f_h$", "$r_m$", "device", "$r_m$", "$f_m$", "one"
    sent = "$\\hat r_m$", "$\\hat f_m$", "waves", "$\\hat r_s$", "$\\hat f_s$", "two"
    d.ports(*hand, *sent, "$r_s$", "$f_s$", "team")
    d.block("operator", "Trust in operator\n$T_{rh,i}$|(4.2), (4.3)", 1.86, 2.34, 1.4, 0.72)
    d.block("policy", "Leader: the\nmost trusted", 3.86, 3.04, 1.16)
    d.block("robots", "Trust in each\nrobot $T_{hr,i}$|(4.1)", 5.76, 3.04, 1.2, 0.74)
    d.circle("choice", 3.86, 2.34)
    d.signal("$P_h$", "human.n", "operator.w", leg=0, at=0.6)
    d.signal("$\\beta_{i_k}$", "operator.e", "waves.n-0.2", leg=0)
    d.signal("$P_{r,i}$", "team.n+0.3", "robots.s+0.44", side=-1)
    d.signal("$T_{hr,i}$", "robots.w", "policy.e")
    d.decision("$i_k$", "policy.s", "waves.n+0.2", at=0.22, side=-1)
    d.decision("switches both ends", "choice.e", "team.n-0.3", at=0.54)
    return d
