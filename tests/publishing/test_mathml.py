"""Formulas: oracle is the MathML one expects by hand; negative controls are formulas that must not pass."""

import re
from xml.etree import ElementTree

import pytest

from trustlab.publishing.html_report import markdown_html
from trustlab.publishing.mathml import MathError, MathMask, equation_html, to_mathml


@pytest.mark.parametrize(
    ("latex", "part"),
    [
        (r"a_r", "<msub><mi>a</mi><mi>r</mi></msub>"),
        (r"a < b", "<mo>&lt;</mo>"),
        (r"\hat P_r", 'accent="true"'),
        (r"\mathbf{x}", "\U0001d431"),
        (r"\boldsymbol{\theta}", "\U0001d73d"),
        (r"\begin{aligned} a &= b \\ c &= d \end{aligned}", "<mtable"),
        (r"\begin{cases} a & b \\ c & d \end{cases}", "<mtable"),
        (r"\operatorname*{arg\,min}_x f", "min"),
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
        (r"x_{", "braces"),
        (r"x}", "braces"),
        (r"\left( a", "left"),
        (r"a & b", "&"),
        (r"a \\ b", "line break"),
        (r"\begin{tabular}a\end{tabular}", "tabular"),
        (r"\newcommand{\x}{y}\x", "newcommand"),
        (r"\eqref{a}", "eqref"),
        (r"\tag{1}", "no available tokens"),
        (r"a \tag{1} b \tag{2}", "tag"),
    ],
)
def test_formula_that_would_lose_a_part_is_refused_by_name(latex, named):
    with pytest.raises(MathError, match=re.escape(named)) as caught:
        to_mathml(latex)
    assert latex in str(caught.value)


def test_numbers_come_from_tags_alone():
    assert '<span class="tag">(2.3)</span>' in equation_html(r"a = b \tag{2.3}")
    assert "(1)" not in equation_html(r"\begin{align} a &= b \\ c &= d \end{align}")
    both = equation_html(r"\begin{align} a &= b \tag{2.5}\\ c &= d \tag{2.6} \end{align}")
    assert both.count("number-of-row") == 2


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
    assert "\ue000" not in page


def test_formula_survives_markdown():
    page = markdown_html("*so $a_b*c_d*e$ is* and | $|x|$\n\n| a | b |\n|---|---|\n| $|y|$ | $z_1$ __w__ |\n")
    assert page.count("<math") == 4
    assert "<strong>w</strong>" in page
    assert page.count("<td") == 2
    assert page.startswith("<p><em>so <math")


def test_blocks_and_environments_are_displayed():
    page = markdown_html("Before\n$$\na_b\n= c\n$$\nafter\n\n\\begin{align}\na &= b\n\\end{align}\n")
    assert page.count('class="equation"') == 2
    assert page.count('display="block"') == 2


def test_mask_gives_back_what_was_typed():
    source = "a $x_1$ b $$y$$ c `$z$`"
    mask = MathMask(source)
    assert mask.as_written(mask.text) == source
    assert len(mask.formulas) == 2
