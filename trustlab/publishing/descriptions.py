"""What one sees in a figure of Matplotlib: in words for who does not see it, and in numbers for the viewer of a report."""

import json
import re
import unicodedata

import numpy as np

GREEK = ("alpha", "beta", "gamma", "delta", "zeta", "theta", "mu", "sigma", "tau", "phi", "omega")
# Lines and ticks of a panel that are described one by one.
MOST_LINES = 8


def spoken(text: str) -> str:
    """Return a label with its mathematics as plain text."""
    letters = {name: unicodedata.lookup(f"GREEK SMALL LETTER {name}") for name in GREEK}
    text = re.sub(r"\\([A-Za-z]+)", lambda found: letters.get(found[1], ""), text)
    return " ".join(re.sub(r"[${}\\]", "", text).split())


def describe(figure) -> str:
    """Return a figure in words: for each panel its axes with their ranges, and how each named line runs."""
    panels = [axes for axes in figure.axes if axes.get_visible() and (axes.axison or axes.name == "3d")]
    told = [_panel(axes) for axes in panels if axes.get_label() != "<colorbar>"]
    scales = [spoken(axes.get_ylabel() or axes.get_xlabel()) for axes in panels if axes.get_label() == "<colorbar>"]
    count = [f"{len(told)} panels."] if len(told) > 1 else []
    colours = [f"Colours show {', '.join(dict.fromkeys(scales))}."] if any(scales) else []
    return " ".join([*count, *filter(None, told), *colours])


def _panel(axes) -> str:
    """Return one panel in words."""
    title = next((spoken(words) for side in ("left", "center", "right") if (words := axes.get_title(loc=side))), "")
    against = f"{_axis(axes.yaxis)} against {_axis(axes.xaxis)}"
    if axes.name == "3d":
        against = ", ".join(spoken(getattr(axes, f"get_{name}label")()) or name for name in "xyz")
    lines = {name: line for line in axes.lines if (name := _name(line)) and len(line.get_xdata()) > 2}
    runs = [f"{name} {_run(line)}" for name, line in list(lines.items())[:MOST_LINES]]
    legend = axes.get_legend()
    keys = [spoken(text.get_text()) for text in legend.get_texts()] if legend else []
    if others := [key for key in keys if key not in lines]:
        runs.append(f"also shown: {', '.join(others)}")
    return "; ".join(filter(None, [title, against, *runs])) + "."


def _name(artist) -> str:
    """Return the name that an author gave to a line, or nothing."""
    label = str(artist.get_label())
    return "" if label.startswith("_") else spoken(label)


def _axis(axis) -> str:
    """Return label and range of an axis, or the names along it."""
    label = spoken(axis.get_label_text()) or ("horizontal axis" if axis.axis_name == "x" else "vertical axis")
    names = [spoken(tick.get_text()) for tick in axis.get_ticklabels()]
    if any(re.search(r"[^\W\d_]{2}|[A-Z]\d", name) for name in names):
        return f"{label} ({', '.join(filter(None, names[:MOST_LINES]))}{' …' if len(names) > MOST_LINES else ''})"
    low, high = sorted(axis.get_view_interval())
    return f"{label} from {low:.3g} to {high:.3g}"


def _run(line) -> str:
    """Return how a line runs: where it begins and ends, and its extremes between."""
    heights = np.asarray(line.get_ydata(orig=False), dtype=float)
    heights = heights[np.isfinite(heights)]
    if not heights.size:
        return "is empty"
    first, last, low, high = heights[0], heights[-1], heights.min(), heights.max()
    if low == high:
        return f"stays at {first:.3g}"
    run = f"goes from {first:.3g} to {last:.3g}"
    return run if {low, high} == {first, last} else f"{run}, between {low:.3g} and {high:.3g}"


def calibrate(figure) -> None:
    """Name the panels and lines of a figure in its drawing so that a viewer can read values from it."""
    for axes in figure.axes:
        if axes.name != "rectilinear" or not {axes.get_xscale(), axes.get_yscale()} <= {"linear", "log"}:
            continue
        sides = {
            name: [*axis.get_view_interval(), axis.get_scale(), spoken(axis.get_label_text()) or name]
            for name, axis in (("x", axes.xaxis), ("y", axes.yaxis))
        }
        axes.patch.set_gid(json.dumps(sides))
        for line in axes.lines:
            if line.get_gid() is None and _name(line):
                line.set_gid(f"line:{_name(line)}")
