"""
LaTeX formulas to MathML: latex2mathml converts; what it leaves out or unconverted is refused by
name.
"""

import html
import re
from collections.abc import Iterator
from xml.etree.ElementTree import Element, tostring

from trustlab.models.extras import extra

with extra("reports"):
    from latex2mathml.converter import Converter

ENVIRONMENTS = (
    "split",
    "aligned",
    "align*",
    "cases",
    "array",
    "matrix",
    "pmatrix",
    "bmatrix",
    "vmatrix",
)
PARTS = {
    "mfrac": 2,
    "msub": 2,
    "msup": 2,
    "mover": 2,
    "munder": 2,
    "mroot": 2,
    "msubsup": 3,
    "munderover": 3,
}


class MathError(ValueError):
    """A formula that cannot be shown: the message quotes it and says what to change."""


def to_mathml(latex: str, display: bool = False) -> str:
    r"""Return a formula as a ``<math>`` element.

    Parameters
    ----------
    latex : str
        The formula without its dollars.
    display : bool
        Whether it stands on a line of its own.

    Returns
    -------
    str
        MathML that needs no script, with the LaTeX in ``alttext``.

    Raises
    ------
    MathError
        If any part of the formula would be lost: an unknown command or environment, a missing
        argument, a stray brace.
    """
    unknown = [name for name in re.findall(r"\\begin\{(.*?)\}", latex) if name not in ENVIRONMENTS]
    if unknown:
        known = ", ".join(ENVIRONMENTS)
        raise _refused(
            latex, [f"there is no environment {name!r}; use one of {known}" for name in unknown]
        )
    # latex2mathml knows aligned by the name of split only
    source = latex.strip().replace("{aligned}", "{split}")
    try:
        math = Converter(display="block" if display else "inline").convert_to_element(source)
    except Exception as error:  # its errors are of many classes, most without words
        words = re.sub(
            r"(?<=[a-z])(?=[A-Z])", " ", type(error).__name__.removesuffix("Error")
        ).lower()
        raise _refused(latex, [f"{words} {error}".strip()]) from None
    dropped = re.findall(r"\\(?:re)?newcommand|\\tag|\\operatorname\*", latex)
    faults = [fault for element in math.iter() for fault in _faults(element)]
    faults += [f"{name} is not supported" for name in dropped]
    if faults:
        raise _refused(latex, faults)
    for element in math.iter():
        element.text = html.unescape(
            element.text or ""
        )  # entities would be escaped once more below
        if element.tag == "mover" and element[1].tag == "mo":
            element.set("accent", "true")  # else browsers set it small and far above its letter
    math.attrib.pop("xmlns", None)  # needless within HTML
    math.set("alttext", " ".join(latex.split()))
    return tostring(math, encoding="unicode")


def _refused(latex: str, faults: list[str]) -> MathError:
    return MathError(
        f"the formula “{latex.strip()}” cannot be shown: {'; '.join(dict.fromkeys(faults))}"
    )


def _faults(element: Element) -> Iterator[str]:
    """Yield what the converter passed through without converting it."""
    name, text = element.tag, element.text or ""
    if name != "mtext" and "\\" in text:
        yield f"{text} is not supported"
    if name == "mi" and text in ("&", "{", "}"):
        yield f"there is a stray {text!r}"
    if name in PARTS and len(element) != PARTS[name]:
        yield f"a part is missing ({name} needs {PARTS[name]}, found {len(element)})"
    if element.get("linebreak"):
        yield (
            r"a line break is outside an environment; "
            r"put \begin{aligned} … \end{aligned} round it"
        )
    if element.get("mathvariant", "normal") != "normal":
        yield (
            f"browsers do not show the alphabet {element.get('mathvariant')!r}; use \\mathbf or "
            "\\mathrm"
        )
