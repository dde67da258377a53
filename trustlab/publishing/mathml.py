"""LaTeX formulas to MathML, once, while a report is built: a formula either converts wholly or says why not."""

import html
import re
from xml.etree.ElementTree import Element, SubElement, tostring

__all__ = ["MathError", "MathMask", "equation_html", "to_mathml"]


class MathError(ValueError):
    """A formula that cannot be shown: the message quotes it and says what to change."""


# What LaTeX calls them -> what the converter knows. Numbers are never invented: (2.3) comes from \tag{2.3}.
ENVIRONMENTS = {
    "equation": None,
    "equation*": None,
    "displaymath": None,
    "align": "align*",
    "align*": "align*",
    "alignat": "align*",
    "alignat*": "align*",
    "aligned": "split",
    "alignedat": "split",
    "split": "split",
    "gather": "matrix",
    "gather*": "matrix",
    "gathered": "matrix",
    "multline": "matrix",
    "multline*": "matrix",
    "cases": "cases",
    "dcases": "cases",
    "array": "array",
    **{
        name: name
        for name in ("matrix", "pmatrix", "bmatrix", "Bmatrix", "vmatrix", "Vmatrix", "smallmatrix")
    },
}
DISPLAY_ENVIRONMENTS = ("equation", "align", "alignat", "gather", "multline", "displaymath")
ARITY = {"mfrac": 2, "msub": 2, "msup": 2, "mover": 2, "munder": 2, "mroot": 2, "msubsup": 3, "munderover": 3}
TAG = "\ue002"  # marks the number of a row until it has a column of its own
ACCENTS = {"^", "~", "\u00af", "\u02d9", "\u00a8", "\u2192", "\u02c7", "\u02d8", "\u02dc", "\u02c6"}
SPACES = {
    "negativethinmathspace": "-0.167em",
    "negativemediummathspace": "-0.222em",
    "negativethickmathspace": "-0.278em",
}
FENCED = r"^[ ]{0,3}(?P<fence>`{3,}|~{3,})[^\n]*\n.*?(?:^[ ]{0,3}(?P=fence)[`~]*[ \t]*$|\Z)"
SPAN = r"(?P<ticks>(?<!`)`+(?!`)).*?(?<!`)(?P=ticks)(?!`)"
DISPLAY = r"(?<!\\)\$\$(?P<display>(?:(?!\n[ \t]*\n)[^$`])+?)\$\$"
INLINE = r"(?<![\\$])\$(?![\s$])(?P<inline>(?:\\\$|(?!\n[ \t]*\n)[^$`])+?)(?<![\s\\])\$(?![\d$])"
BLOCK = r"\\begin\{(?P<name>(?:" + "|".join(DISPLAY_ENVIRONMENTS) + r")\*?)\}.*?\\end\{(?P=name)\}"
FIND = re.compile(
    f"(?P<code>{FENCED}|{SPAN})|{DISPLAY}|{INLINE}|(?P<block>{BLOCK})", re.MULTILINE | re.DOTALL
)


def _refuse(latex, why):
    raise MathError(f"the formula “{latex.strip()}” cannot be shown: {why}")


def _prepared(latex):
    """Return the formula in the converter's own dialect, and its tag if it has exactly one."""
    source = re.sub(r"\\label\{[^{}]*\}|\\(?:nonumber|notag)(?![A-Za-z])", "", latex)
    bare = re.sub(r"\\\\|\\[{}]", "", source)
    if bare.count("{") != bare.count("}"):
        _refuse(latex, "its braces do not pair up")
    for word in re.findall(r"\\(newcommand|renewcommand|def|DeclareMathOperator)(?![A-Za-z])", source):
        _refuse(latex, f"\\{word} is not supported; write the formula out")

    def environment(match):
        name = match["name"]
        if name not in ENVIRONMENTS:
            _refuse(latex, f"the environment {name!r} is not supported; use one of {', '.join(ENVIRONMENTS)}")
        own = ENVIRONMENTS[name]
        return "" if own is None else f"\\{match['end']}{{{own}}}"

    if source.count(r"\begin{") != source.count(r"\end{"):
        _refuse(latex, "its \\begin and \\end do not pair up")
    source = re.sub(r"(\\begin\{aligned?at\*?\})\{\d+\}", r"\1", source)
    source = re.sub(r"\\(?P<end>begin|end)\{(?P<name>[^{}]*)\}", environment, source)
    source = re.sub(r"\\operatorname\*?\{arg\s*(?:\\,|~)?\s*(min|max)\}", r"\\arg\1", source)
    source = source.replace(r"\operatorname*{", r"\operatorname{")
    tags = re.findall(r"\\tag\*?\{([^{}]*)\}", source)
    if len(tags) == 1:
        return re.sub(r"\\tag\*?\{[^{}]*\}", "", source), tags[0]
    return re.sub(r"\\tag\*?\{([^{}]*)\}", rf"\\text{{{TAG}(\1)}}", source), None


def _letter(character, variant):
    """Return the letter of the Unicode mathematical alphabet: browsers know only mathvariant='normal'."""
    bases = {"bold": (0x1D400, 0x1D6A8), "bold-italic": (0x1D468, 0x1D71C), "italic": (0x1D434, 0x1D6E2)}
    if variant not in bases or (variant == "italic" and character == "h"):
        return None
    latin, greek = bases[variant]
    if "A" <= character <= "Z":
        return chr(latin + ord(character) - ord("A"))
    if "a" <= character <= "z":
        return chr(latin + 26 + ord(character) - ord("a"))
    if "\u0391" <= character <= "\u03a9":
        return chr(greek + ord(character) - 0x391)
    if "\u03b1" <= character <= "\u03c9":
        return chr(greek + 26 + ord(character) - 0x3B1)
    return None


def _check(element: Element, latex):
    """Tidy one element and its children for browsers; refuse what the converter let through unconverted."""
    if element.text:
        element.text = html.unescape(element.text)
    name, text = element.tag, element.text or ""
    if name != "mtext" and "\\" in text:
        _refuse(latex, f"{text} is not a command that can be converted")
    if (name == "mi" and text in {"&", "{", "}"}) or (name in {"mi", "mo"} and "&" in text):
        _refuse(latex, f"there is a stray {text[:1]!r}")
    if name in ARITY and len(element) != ARITY[name]:
        _refuse(latex, f"a part is missing ({name[1:]} needs {ARITY[name]}, found {len(element)})")
    if name == "mspace":
        if element.get("linebreak"):
            _refuse(
                latex, r"a line break outside an environment; put \begin{aligned} … \end{aligned} round it"
            )
        element.set("width", SPACES.get(element.get("width", "0"), element.get("width", "0")))
    if name == "mi" and len(text) == 1:
        letter = _letter(text, element.get("mathvariant"))
        if letter:
            element.text = letter
            del element.attrib["mathvariant"]
    for child in element:
        _check(child, latex)
    if name == "mtd" and len(element) and (element[-1].text or "").startswith(TAG):
        element[-1].set("class", "tag")
    if name == "mtr" and len(element) and len(element[-1]) and element[-1][-1].get("class") == "tag":
        number = element[-1][-1]
        element[-1].remove(number)
        number.text = number.text.removeprefix(TAG)
        SubElement(element, "mtd", {"class": "number-of-row"}).append(number)
    if name == "mover" and element[1].tag == "mo" and element[1].text in ACCENTS:
        element.set("accent", "true")
        letters = "".join(element[0].itertext())
        element[1].set("stretchy", "true" if len(letters) > 1 else "false")
        if element[1].text == "^":
            element[1].text = "\u02c6"


def _convert(latex, display):
    from latex2mathml.converter import Converter

    source, tag = _prepared(latex)
    converter = Converter(display="block" if display else "inline")
    try:
        math = converter.convert_to_element(source.strip())
    except MathError:
        raise
    except Exception as error:  # the converter raises many kinds, most without words
        words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(error).__name__.removesuffix("Error")).lower()
        _refuse(latex, f"{words}{': ' if str(error) else ''}{error}")
    math.attrib.pop("xmlns", None)
    _check(math, latex)
    if TAG in "".join(math.itertext()):
        _refuse(latex, r"more than one \tag, and not at the end of rows of an align environment")
    if not "".join(math.itertext()).strip():
        _refuse(latex, "nothing is left of it")
    math.set("alttext", " ".join(latex.split()))
    return tostring(math, encoding="unicode"), tag


def to_mathml(latex, display=False):
    r"""Return a formula as a ``<math>`` element.

    Parameters
    ----------
    latex : str
        The formula without its dollars: LaTeX, or one of its display environments.
    display : bool
        Whether it stands on a line of its own.

    Returns
    -------
    str
        MathML that needs no script, with the LaTeX in ``alttext``.

    Raises
    ------
    MathError
        If any part of the formula would be lost: an unknown command or environment, a missing argument, a stray brace.
    """
    return _convert(latex, display)[0]


def equation_html(latex):
    r"""Return a displayed formula with its number at the right margin.

    Parameters
    ----------
    latex : str
        The formula; one ``\tag{2.3}`` in it is set at the margin.

    Returns
    -------
    str
        A ``<span class="equation">`` that scrolls when it is wider than the page.
    """
    math, tag = _convert(latex, display=True)
    number = f'<span class="tag">({html.escape(tag)})</span>' if tag else ""
    return f'<span class="equation"><span class="formula">{math}</span>{number}</span>'


class MathMask:
    r"""Formulas taken out of a text before Markdown sees them, and put back as MathML afterwards.

    ``$a_b$`` and ``$$…$$`` and ``\begin{align}…`` are formulas; ``$5`` is money (a dollar that opens a formula is not
    followed by a space, one that closes it is not preceded by one nor followed by a digit), ``\$`` is a dollar, and code
    is left alone.

    Parameters
    ----------
    text : str
        Markdown, or plain text.
    """

    OPEN, CLOSE = "\ue000", "\ue001"

    def __init__(self, text):
        self.formulas = []  # (latex, display, as written)
        self.text = FIND.sub(self._take, text.replace(self.OPEN, "").replace(self.CLOSE, ""))

    def _take(self, match):
        if match["code"] is not None:
            return match[0]
        latex = next(part for part in (match["display"], match["inline"], match["block"]) if part is not None)
        self.formulas.append((latex, match["inline"] is None, match[0]))
        return f"{self.OPEN}{len(self.formulas) - 1}{self.CLOSE}"

    def _put(self, text, written):
        return re.sub(
            f"{self.OPEN}(\\d+){self.CLOSE}", lambda match: written(*self.formulas[int(match[1])]), text
        )

    def as_written(self, text):
        """Return the text with every formula as it was typed.

        Parameters
        ----------
        text : str
            A part of the masked text.

        Returns
        -------
        str
            The same part, unmasked.
        """
        return self._put(text, lambda latex, display, source: source)

    def as_mathml(self, markup):
        """Return the markup with every formula as MathML.

        Parameters
        ----------
        markup : str
            HTML made from the masked text.

        Returns
        -------
        str
            The same HTML with its formulas.
        """
        return self._put(
            markup, lambda latex, display, _: equation_html(latex) if display else to_mathml(latex)
        )
