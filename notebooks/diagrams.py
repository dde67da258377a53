"""
The block diagrams of the primers, in inches on a page of 6.5.

Blue is velocity, vermilion force, green a wave, grey a signal; dashes are decisions, and two arrows
with a band between them a port, whose product is power. Equation numbers stand below the words of
the block that they define.
"""

import re
from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

COLOURS = {"velocity": "#0067a3", "force": "#ad4500", "wave": "#00785a", "signal": "#4a525b"}
INK, PALE, EDGE, FACE, BAND = "#1f2328", "#5f6770", "#8a929b", "#f4f6f8", "#e3ebf2"
SIZE, LINE = 9.0, 0.165  # points, inches
SIDES = {"n": (0, 1), "e": (1, 0), "s": (0, -1), "w": (-1, 0)}
PLACE = re.compile(r"(\w+)\.([nesw])([+-][\d.]+)?")  # robot.e, or robot.e+0.1 above its middle
BESIDE = {"above": (0, 0.12, "center"), "below": (0, -0.14, "center")}
BESIDE |= {"left": (-0.06, 0, "right"), "right": (0.06, 0, "left")}


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

    def block(self, name, words, x, y, w=1.0, h=0.56, equations=""):
        """Place a block round (x, y); a line of its words stands for one on the page."""
        self.boxes[name] = (x, y, w, h)
        corner, shape = (x - w / 2, y - h / 2), "round,pad=0,rounding_size=0.05"
        self.axis.add_patch(
            FancyBboxPatch(corner, w, h, shape, fc=FACE, ec=EDGE, zorder=3 if words else 1)
        )
        lines = [(line, INK) for line in words.splitlines()]
        lines += [(line, PALE) for line in equations.splitlines()]
        for i, (line, colour) in enumerate(lines):
            self.text(line, x, y + LINE * ((len(lines) - 1) / 2 - i), colour, "center")

    def circle(self, name, x, y, radius=0.1, words="", signs=""):
        """Place a sum with signs as in "+w -s", a product, a contact, or a point on a wire."""
        self.boxes[name] = (x, y, 2 * radius, 2 * radius)
        fill = PALE if radius < 0.03 else "white"
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

    def arrow(self, *places, label="", kind="signal", side="", leg=None, at=0.5, head=True):
        """
        Draw an arrow through places, each the side of a block or a point, turning at right angles.

        The label stands beside the longest leg, or the one of that number, at this fraction.
        """
        points = [self._point(places[0])]
        for place in places[1:]:
            (x0, y0), (x1, y1) = points[-1], self._point(place)
            down = isinstance(place, str) and PLACE.fullmatch(place)[2] in "ns"
            if x0 != x1 and y0 != y1:
                points.append((x1, y0) if down else (x0, y1))
            points.append((x1, y1))
        colour, dashes = COLOURS.get(kind, COLOURS["signal"]), (0, (3.2, 2))
        look = {"color": colour, "lw": 1.3, "ls": dashes if kind == "decision" else "-"}
        self.axis.plot(*zip(*points), **look, solid_capstyle="butt", zorder=2, gid=kind)
        legs = list(pairwise(points))
        if head:
            tip = {"arrowstyle": "-|>,head_width=.17", "color": colour, "lw": 0}
            tip |= {"shrinkA": 0, "shrinkB": 0, "mutation_scale": 15}
            self.axis.annotate("", points[-1], points[-2], arrowprops=tip, zorder=4)
        lengths = [abs(x1 - x0) + abs(y1 - y0) for (x0, y0), (x1, y1) in legs]
        (x0, y0), (x1, y1) = legs[lengths.index(max(lengths)) if leg is None else leg]
        dx, dy, ha = BESIDE[side or ("above" if y0 == y1 else "right")]
        ink = INK if colour == COLOURS["signal"] else colour
        self.text(label, x0 + at * (x1 - x0) + dx, y0 + at * (y1 - y0) + dy, ink, ha)

    def port(self, left, right, there, back, half=0.13):
        """Draw a power port between blocks side by side, `there` as in ("velocity", "$r_m$")."""
        (x0, y), (x1, _) = self._point(f"{left}.e"), self._point(f"{right}.w")
        self.axis.add_patch(Rectangle((x0, y - half), x1 - x0, 2 * half, color=BAND, lw=0))
        ends = f"{left}.e+{half}", f"{right}.w+{half}"
        self.arrow(*ends, kind=there[0], label=there[1])
        ends = f"{right}.w-{half}", f"{left}.e-{half}"
        self.arrow(*ends, kind=back[0], label=back[1], side="below")

    def _point(self, place):
        if not isinstance(place, str):
            return place
        name, side, shift = PLACE.fullmatch(place).groups("0")
        (x, y, w, h), (dx, dy) = self.boxes[name], SIDES[side]
        x, y = x + dx * w / 2 + abs(dy) * float(shift), y + dy * h / 2 + abs(dx) * float(shift)
        return round(x, 6), round(y, 6)  # what should be level is level


V, F, W, D = "velocity", "force", "wave", "decision"


def two_levels():
    """Figs. 1.1 and 2.1: an inner loop that drives, an outer one that says who should."""
    d = Diagram(3.4)
    d.frame("Outer loop: who drives?", 1.98, 2.06, 6.44, 3.32)
    d.frame("", 1.98, 0.4, 6.44, 1.94)
    d.text("Inner loop: driving", 5.7, 0.5, PALE, "right")
    d.block("human", "Operator", 0.62, 1.7, 1.04, 2.6, "$r$ by (2.5)\n$P_h$ by (2.6)")
    d.block("rule", "Rule, $TSC_l$\nand $TSC_u$", 2.66, 2.56, 1.04, 0.74, "(2.8)")
    d.block("tsc", "TSC =\n$a_T P_r - b_T P_h$", 4.2, 2.56, 1.22, 0.74, "(2.1)")
    d.block("means", "Means over\n100 s", 5.82, 2.56, 0.98, 0.74, "(2.4), (2.7)")
    d.block("auto", "Autonomous\ncontroller", 2.72, 0.72, 1.1, 0.54)
    for name, x, y in (("manual", 3.61, 1.4), ("alone", 3.61, 1.04), ("switch", 4.11, 1.22)):
        d.circle(name, x, y, 0.035)
    d.block("robot", "Robot", 5.0, 1.22, 0.84)
    d.circle("out", 5.82, 1.22, 0.028)
    d.circle("seen", 5.82, 0.6, 0.028)
    d.arrow("human.e-0.3", "manual.w", label="command $u_h$", at=0.55)
    d.arrow("auto.e", (3.45, 0.72), "alone.w", label="$u_a$", leg=1)
    d.axis.plot((3.64, 4.08), (1.4, 1.22), color=INK)
    d.arrow("switch.e", "robot.w", label="$u$", at=0.4)
    d.arrow("robot.e", "out.w", head=False)
    d.arrow("out.n", "means.s", label="speed, $e$", side="left")
    d.arrow("out.s", "seen.n", (5.82, 0.6), "auto.e-0.12", label="deviation $e$", at=0.45)
    d.arrow("seen.s", (5.82, 0.12), (0.62, 0.12), "human.s", label="what the operator sees", at=0.2)
    d.arrow("means.w", "tsc.e", label="$P_r$, $P_h$")
    d.arrow("tsc.w", "rule.e", label="TSC")
    d.arrow("rule.w", "human.e+0.86", label="suggestion", kind=D, at=0.57)
    d.arrow("human.e-0.06", (3.86, 1.64), (3.86, 1.34), label="mode $M$", kind=D, at=0.16)
    return d


def model_loop():
    """Chapter 2 as five equations: the mode acts on the load, and on what reaches the robot."""
    d = Diagram(2.06)
    d.block("rule", "Rule", 0.66, 1.3, 0.9, equations="(2.8)")
    d.block("use", "Utilization", 2.06, 1.3, 0.98, equations="(2.5)")
    d.block("hand", "Human\nperformance", 3.52, 1.3, 1.08, 0.72, "(2.6)")
    d.circle("times", 4.66, 1.3, words="×")
    d.block("robot", "Robot\nperformance", 5.8, 1.3, 1.1, 0.72, "(2.3)")
    d.block("tsc", "$a_T P_r - b_T P_h$", 3.0, 0.4, 1.4, equations="(2.1)")
    d.circle("m", 1.3, 1.3, 0.028)
    d.circle("p", 4.3, 1.3, 0.028)
    d.arrow("rule.e", "use.w", label="$M$", kind=D, at=0.67)
    d.arrow("use.e", "hand.w", label="$r$")
    d.arrow("hand.e", "times.w", label="$P_h$", at=0.4)
    d.arrow("times.e", "robot.w", label="$M P_h$")
    said = "$M$ = 1 manual, $M$ = 0 autonomous"
    d.arrow("m.n", (1.3, 1.82), (4.66, 1.82), "times.n", label=said, kind=D)
    d.arrow("p.s", (4.3, 0.52), "tsc.e+0.12", label="$P_h$", leg=0)
    d.arrow("robot.s", (5.8, 0.28), "tsc.e-0.12", label="$P_r$", at=0.4)
    d.arrow("tsc.w", (0.66, 0.4), "rule.s", label="TSC")
    return d


def teleoperation():
    """Figs. 3.1, 3.4, 3.5 and 3.8: a chain of ports, which trust reaches through two scales."""
    d = Diagram(4.3)
    d.frame("Channel: passive, Theorem 3", 3.91, 0.34, 6.44, 4.22)
    d.block("human", "Operator", 0.58, 3.46, 0.96, 0.9, "assumed\npassive")
    d.block("device", "Haptic device", 2.3, 3.46, 1.3, 0.9, "$r$-passive\n(3.8)–(3.11)")
    d.block("one", "Scattering 1", 4.5, 3.46, 1.06, 0.9, "scale $\\beta$\n(3.12), (3.13)")
    words = "Delays\n$T_1(t)$, $T_2(t)$\nand gains\n$f_1$, $f_2$"
    d.block("delay", words, 5.92, 2.18, 0.88, 3.46, "(3.16)")
    d.block("two", "Scattering 2", 4.5, 0.9, 1.06, 0.9, "scale $\\alpha$\n(3.12), (3.13)")
    d.block("guard", "Passivity\ncontroller", 3.13, 0.9, 0.9, 0.9, "Theorem 4\n(3.19)")
    d.block("robot", "Robot and\nguidance", 1.86, 0.9, 0.9, 0.9, "(A.1)")
    d.block("world", "Environ-\nment", 0.52, 0.9, 0.84, 0.9, "passive")
    d.port("human", "device", (F, "$f_h$"), (V, "$r_m$"))
    d.port("device", "one", (V, "$r_m$"), (F, "$f_m$"))
    d.port("guard", "two", (F, "$f_s$"), (V, "$r_s$"))
    d.port("robot", "guard", (F, "$f'_s$"), (V, "$r_s$"))
    d.port("world", "robot", (F, "$f_e$"), (V, "$v$"))
    for name, place, waves in (("one", 1.28, "u_l v_l"), ("two", -1.28, "u_r v_r")):
        there, back = (f"${wave}$" for wave in waves.split())
        d.arrow(f"{name}.e+0.13", f"delay.w{place + 0.13:+}", label=there, kind=W)
        d.arrow(f"delay.w{place - 0.13:+}", f"{name}.e-0.13", label=back, kind=W, side="below")
    words = "Performance\n$P_h$, $P_r$"
    d.block("means", words, 0.66, 2.18, 1.1, 0.76, "(3.26), (3.27)")
    d.block("trust_h", "Trust in operator $T_{rh}$", 2.7, 2.5, 1.78, 0.52, "(3.3), (3.5)")
    d.block("trust_r", "Trust in robot $T_{hr}$", 2.7, 1.86, 1.78, 0.52, "(3.2), (3.5)")
    d.arrow("human.s+0.08", "means.n", label="$u_h$")
    d.arrow("world.n", "means.s-0.14", label="error $e$")
    d.arrow("means.e+0.18", "trust_h.w-0.14", label="$P_h$")
    d.arrow("means.e-0.18", "trust_r.w+0.14", label="$P_r$", side="below")
    d.arrow("trust_h.e", "one.s", label="$\\beta$", leg=1)
    d.arrow("trust_r.e", "two.n", label="$\\alpha$", leg=1)
    d.arrow("trust_r.s-0.84", "robot.n", label="1 − $\\alpha$")
    return d


def haptic_device():
    """Figs. 3.6 and 3.11: the output is velocity + Λ position, and γ scales what the hand feels."""
    d = Diagram(3.3)
    d.frame("", 0.62, 0.2, 5.86, 3.2)
    d.circle("force", 1.0, 1.48, signs="+w +n -s")
    d.block("device", "Device", 1.98, 1.48, 0.98, 0.6, "(3.8)")
    d.block("local", "Local control", 1.98, 2.38, 1.14, 0.6, "$-B\\dot x - Kx$")
    for name, words, x, y in (
        ("sum", "∫", 3.46, 2.48),
        ("weight", "$\\Lambda$", 4.36, 2.48),
        ("small", "$\\gamma$", 3.46, 0.58),
    ):
        d.block(name, words, x, y, 0.46, 0.42)
    d.circle("out", 5.02, 1.48, signs="+w +n")
    for name, x in (("v", 2.98), ("w", 3.46), ("r", 5.5)):
        d.circle(name, x, 1.48, 0.028)
    d.arrow((0.06, 1.48), "force.w", label="$f_h$", kind=F, at=0.3)
    d.arrow("force.e", "device.w")
    d.arrow("device.e", "out.w", label="$\\dot x$", at=0.75)
    d.arrow("v.n", "local.e-0.1", label="$\\dot x$", leg=0)
    d.arrow("w.n", "sum.s")
    d.arrow("sum.w", "local.e+0.1", label="$x$")
    d.arrow("sum.e", "weight.w", label="$x$")
    d.arrow("weight.e", "out.n", label="$\\Lambda x$", leg=1, at=0.4)
    d.arrow("local.w", "force.n", label="$f_{local}$", leg=1, at=0.42)
    d.arrow("out.e", (6.44, 1.48), label="$r_m$", kind=V, at=0.9)
    d.arrow((6.44, 0.58), "small.e", label="$f''_m$", kind=F, at=0.3)
    d.arrow("small.w", (1.0, 0.58), "force.s", label="$f_m$ = $\\gamma f''_m$", kind=F)
    said = "$r''_m$ = $r_m/\\gamma$, to the operator"
    d.arrow("r.n", (5.5, 2.95), (0.06, 2.95), label=said, kind=V)
    return d


def channel():
    """Fig. 3.7: scattering outside the delays, the scales outside the scattering."""
    d = Diagram(2.34)
    d.frame("", 0.42, 0.3, 6.1, 2.02)
    d.block("one", "Scattering", 1.98, 1.12, 0.84, 1.3, "(3.13)")
    d.block("two", "Scattering", 4.7, 1.12, 0.84, 1.3, "(3.13)")
    for name, words, x, y, w in (
        ("beta", "$\\beta(t)$", 0.92, 0.72, 0.5),
        ("t1", "$T_1(t)$", 3.0, 1.52, 0.56),
        ("f1", "$f_1$", 3.74, 1.52, 0.42),
        ("f2", "$f_2$", 2.93, 0.72, 0.42),
        ("t2", "$T_2(t)$", 3.67, 0.72, 0.56),
        ("alpha", "$\\alpha(t)$", 5.72, 1.52, 0.5),
    ):
        d.block(name, words, x, y, w, 0.42)
    for start, end, label, kind, at in (
        ((0.06, 1.52), "one.w+0.4", "$r_m$", V, 0.11),
        ("one.w-0.4", "beta.e", "$f'_m$", F, 0.5),
        ("beta.w", (0.06, 0.72), "$f_m$", F, 0.75),
        ("one.e+0.4", "t1.w", "$u_l$", W, 0.5),
        ("t1.e", "f1.w", "", W, 0.5),
        ("f1.e", "two.w+0.4", "$v_r$", W, 0.5),
        ("two.w-0.4", "t2.e", "$u_r$", W, 0.5),
        ("t2.w", "f2.e", "", W, 0.5),
        ("f2.w", "one.e-0.4", "$v_l$", W, 0.5),
        ("two.e+0.4", "alpha.w", "$r'_s$", V, 0.5),
        ("alpha.e", (6.44, 1.52), "$r_s$", V, 0.64),
        ((6.44, 0.72), "two.e-0.4", "$f_s$", F, 0.13),
    ):
        d.arrow(start, end, label=label, kind=kind, at=at)
    d.arrow((5.72, 2.3), "alpha.n", label="trust $T_{hr}$", at=0.24, side="left")
    d.arrow((0.92, 0.04), "beta.s", label="trust $T_{rh}$", at=0.28)
    d.text("power in: $r_m^T f_m$", 0.42, 2.18, PALE)
    d.text("power out: $r_s^T f_s$", 6.1, 0.14, PALE, "right")
    return d


def robot_side():
    """Figs. 3.9 and 3.10: the observer and the controller guard the port, not the robot."""
    d = Diagram(2.94)
    d.frame("Passivity controller", 0.56, 0.36, 2.3, 2.3)
    for name, x, y in (("r", 1.0, 1.78), ("r2", 1.88, 1.78), ("f2", 1.88, 0.66)):
        d.circle(name, x, y, 0.028)
    d.circle("f", 1.0, 0.66, signs="+n +e")
    d.circle("ref", 2.72, 1.78, signs="+w +n")
    for name, words, x, y, w, h in (
        ("z", "$z(t)$", 1.0, 1.24, 0.5, 0.42),
        ("po", "PO", 1.88, 1.24, 0.46, 0.42),
        ("low", "Velocity\nloop", 3.62, 1.78, 0.8, 0.6),
        ("robot", "Robot", 4.74, 1.78, 0.74, 0.6),
        ("world", "Environ-\nment", 6.0, 1.78, 0.8, 0.6),
        ("one", "1 − $\\alpha$", 2.72, 2.58, 0.6, 0.42),
        ("auto", "Autonomous\ncontroller", 3.9, 2.58, 1.06, 0.54),
    ):
        d.block(name, words, x, y, w, h)
    d.block("guide", "Guiding force", 3.62, 0.66, 1.1, equations="$-k_{ffa}\\, e$")
    d.arrow((0.06, 1.78), "ref.w", label="$r_s$", kind=V, at=0.09)
    d.arrow("r.s", "z.n", kind=V)
    d.arrow("z.s", "f.n", label="$z r_s$", kind=F, side="left")
    d.arrow("r2.s", "po.n")
    d.arrow("f2.n", "po.s")
    d.arrow("po.w", "z.e", label="on", kind=D)
    d.arrow("guide.w", "f.e", label="$f'_s$", kind=F, at=0.25)
    d.arrow("f.w", (0.06, 0.66), label="$f_s$", kind=F, at=0.75)
    d.arrow("ref.e", "low.w", label="$v_{ref}$")
    d.arrow("low.e", "robot.w")
    d.port("robot", "world", (V, "$v$"), (F, "$f_e$"))
    d.arrow("robot.n", (4.74, 2.58), "auto.e", label="error $e$", leg=0, at=0.4)
    d.arrow("robot.s", (4.74, 0.66), "guide.e", label="error $e$", leg=0)
    d.arrow("auto.w", "one.e", label="$A_c$")
    d.arrow((1.9, 2.58), "one.w", label="$T_{hr}$", at=0.4)
    d.arrow("one.s", "ref.n")
    return d


def team():
    """Figs. 4.1, 4.3 and 4.4: the same chain, whose far end moves from robot to robot."""
    d = Diagram(3.5)
    d.block("team", "", 5.9, 1.14, 1.02, 1.7)
    for name, words, x, w, equations in (
        ("human", "Operator", 0.48, 0.8, "(4.30)"),
        ("device", "Haptic\ndevice", 1.6, 0.7, "(4.6)"),
        ("one", "Filter\n$F_1$", 2.6, 0.58, "(4.16)"),
        ("waves", "Switched\nchannel", 3.66, 0.84, "Theorem 5"),
        ("two", "Filter\n$F_2$", 4.73, 0.58, "(4.16)"),
    ):
        d.block(name, words, x, 1.14, w, 0.9, equations)
    d.text("Team (4.19)", 5.9, 1.86, PALE, "center")
    for name, words, x, y in (
        ("leader", "$i_k$", 5.64, 1.14),
        ("first", "1", 6.2, 1.52),
        ("last", "$N$", 6.2, 0.76),
    ):
        d.block(name, words, x, y, 0.3, 0.3)
    d.arrow("leader.n", (5.64, 1.52), "first.w", head=False)
    d.arrow("leader.s", (5.64, 0.76), "last.w", head=False)
    d.arrow("first.s", "last.n", head=False)
    d.text("$i_k$: the leader", 5.9, 0.42, PALE, "center")
    d.port("human", "device", (F, "$f_h$"), (V, "$r_m$"))
    d.port("device", "one", (V, "$r_m$"), (F, "$f_m$"))
    d.port("one", "waves", (V, "$\\hat r_m$"), (F, "$\\hat f_m$"))
    d.port("waves", "two", (V, "$\\hat r_s$"), (F, "$\\hat f_s$"))
    d.port("two", "team", (V, "$r_s$"), (F, "$f_s$"))
    d.block("operator", "Trust in operator\n$T_{rh,i}$", 1.86, 2.34, 1.4, 0.72, "(4.2), (4.3)")
    d.block("policy", "Leader: the\nmost trusted", 3.86, 3.04, 1.16)
    d.block("robots", "Trust in each\nrobot $T_{hr,i}$", 5.76, 3.04, 1.2, 0.74, "(4.1)")
    d.circle("choice", 3.86, 2.34, 0.028)
    d.arrow("human.n", (0.48, 2.34), "operator.w", label="$P_h$", leg=0, at=0.6)
    d.arrow("operator.e", "waves.n-0.2", label="$\\beta_{i_k}$", leg=0)
    d.arrow("team.n+0.3", "robots.s+0.44", label="$P_{r,i}$", side="left")
    d.arrow("robots.w", "policy.e", label="$T_{hr,i}$")
    d.arrow("policy.s", "waves.n+0.2", label="$i_k$", kind=D, at=0.22, side="left")
    d.arrow("choice.e", "team.n-0.3", label="switches both ends", kind=D, at=0.54)
    return d
