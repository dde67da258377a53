"""
Formulas: oracle is the MathML one expects by hand; negative controls are formulas that must not
pass.
"""

import re
from xml.etree import ElementTree

import pytest

from trustlab.publishing.mathml import MathError, to_mathml
from trustlab.publishing.report_page import markdown_html


@pytest.mark.parametrize(
    ("latex", "part"),
    [
        (r"a_r", "<msub><mi>a</mi><mi>r</mi></msub>"),
        (r"a < b", "<mo>&lt;</mo>"),
        (r"\hat P_r", 'accent="true"'),
        (r"\mathbf{x}", "\U0001d431"),
        (r"\begin{aligned} a &= b \\ c &= d \end{aligned}", "<mtable"),
        (r"\begin{cases} a & b \\ c & d \end{cases}", "<mtable"),
        (r"\operatorname{arg}", "<mo>arg</mo>"),
        (r"\text{a < b & c}", "&lt;"),
    ],
)
def test_formula_becomes_well_formed_mathml(latex, part):
    math = to_mathml(latex)
    assert ElementTree.fromstring(math).tag == "math"
    assert part in math


@pytest.mark.parametrize(
    ("latex", "named"),
    [
        (r"\foo_1", "foo"),
        (r"\frac{a}", "missing"),
        (r"x_{", "missing super script or subscript"),
        (r"x}", "stray"),
        (r"\left( a", "left"),
        (r"a & b", "&"),
        (r"a \\ b", "line break"),
        (r"\begin{tabular}a\end{tabular}", "tabular"),
        (r"\newcommand{\x}{y}\x", "newcommand"),
        (r"\eqref{a}", "eqref"),
        (r"a = b \tag{1}", "tag"),
        (r"\boldsymbol{\theta}", "bold-italic"),
        (r"\operatorname*{min}_x f", "operatorname*"),
        (r"\begin{align}a &= b\end{align}", "'align'"),
        ("", "no available tokens"),
    ],
)
def test_formula_that_would_lose_a_part_is_refused_by_name(latex, named):
    with pytest.raises(MathError, match=re.escape(named)) as caught:
        to_mathml(latex)
    assert latex in str(caught.value)


@pytest.mark.parametrize(
    "source",
    [
        "`$x_1$`",
        "```\necho $HOME and $PATH$\n```",
        "~~~\n$$a$$\n~~~",
        "text\n\n    indented $x$ code",
        "It costs $5 and $6, not $ 7 $.",
        r"A price of \$5 and \$6.",
        "`` a ` $x$ ``",
    ],
)
def test_code_and_money_are_not_formulas(source):
    page = markdown_html(source)
    assert "<math" not in page
    assert "$" in page


def test_formula_survives_markdown():
    page = markdown_html(
        "*so $a_b*c_d*e$ is* and | $|x|$\n\n| a | b |\n|---|---|\n| $y$ | $z_1$ __w__ |\n"
    )
    assert page.count("<math") == 4
    assert "<strong>w</strong>" in page
    assert page.count("<td") == 2
    assert page.startswith('<p><em>so <span class="whole"><math')


def test_blocks_and_environments_are_displayed():
    page = markdown_html(
        "Before\n$$\na_b\n= c\n$$\nafter\n\n\\begin{align*}\na &= b\n\\end{align*}\n"
    )
    assert page.count('class="equation"') == 2
    assert page.count('display="block"') == 2
