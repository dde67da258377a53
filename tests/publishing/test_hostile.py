"""Names, logs and outputs that attack: a real browser runs nothing of them and fetches nothing.

Chromium is the oracle: what fires is counted by a variable of the window and by dialogs, what is
fetched by the requests that are routed. The same markup without escaping and without a policy does
fire.
"""

import dataclasses
import html
import importlib
import pkgutil
import re
import tempfile
from pathlib import Path
from types import SimpleNamespace

import networkx as nx
import numpy as np
import pandas as pd
import pytest
from nbformat.v4 import new_code_cell

import trustlab
import trustlab as tl
from tests.publishing.walk import chromium
from tests.publishing.world import ROOT, make, publish, write_book
from trustlab.allocation.correction_run import CorrectionRun
from trustlab.allocation.ranges import RangeIntervals
from trustlab.identification.posterior.population import Population
from trustlab.identification.posterior.result import MODEL as MODEL_NAMES
from trustlab.identification.regression import ArxResult
from trustlab.models.display import Result
from trustlab.publishing.tables import table_html
from trustlab.reproduction.calibration import Calibration
from trustlab.reproduction.reconstruction.reconstruction import reconstruct_study
from trustlab.sessions.session import Metadata, Session
from trustlab.studies.mixed import FormulaModel
from trustlab.studies.ordinal import OrdinalModel
from trustlab.studies.planning.virtual_study import VirtualStudy
from trustlab.studies.questionnaires import Questionnaire, ScaleScores
from trustlab.studies.report import report
from trustlab.teleoperation import Passivity, TeamTrial
from trustlab.trust.comparison import MEASURES, TrustComparison

FIRE = "window.top.fired=(window.top.fired||0)+1"
AWAY = "https://attacker.invalid/"
ATTACKS = {
    "image": f'<img src=x onerror="{FIRE}">',
    "comment": f'<!--><img src=x onerror="{FIRE}">-->',
    "script": f"</script></style></title></textarea><script>{FIRE}</script>",
    "form": f'<form action="{AWAY}form"><button id=go>go</button></form>',
    "formaction": f'<form><button id=go formaction="{AWAY}formaction">go</button></form>',
    "link": f'<a id=go href="java&#9;script:{FIRE}">go</a>',
    "refresh": f'<meta http-equiv="Refresh" content="0; url={AWAY}refresh">',
    "image set": f"<p style=\"background: image-set('{AWAY}set.png' 1x)\">",
    "escaped url": rf"<p style='background: u\72l({AWAY}url.png)'>",
    "style in a picture": f'<svg><style><img src=x onerror="{FIRE}"></style></svg>',
    "preconnect": f'<link rel=stylesheet href="{AWAY}a.css">',
    "base": f'<base href="{AWAY}"><img src=b.png>',
    "frame": f'<iframe srcdoc="<script>{FIRE}</script>"></iframe>',
    "handler": f'" onfocus="{FIRE}" autofocus tabindex="1" x="',
    "comment and script": f"<!--<script>{FIRE}",
    "template": "$DATA $TITLE {{ 7 * 7 }} $\\nosuch{x}$",
}
NAME = " ".join(ATTACKS.values())


@pytest.fixture(scope="module")
def browser():
    yield from chromium()


@pytest.fixture(scope="module")
def visit(browser):
    """
    Return a function that shows a page in Chromium, presses what can be pressed, and tells what
    fired and was fetched.
    """
    page = browser.new_page()
    asked, dialogs = [], []
    # "No content" leaves the page where it is, so that what came of a press can be read.
    page.route("**/*", lambda route: (asked.append(route.request.url), route.fulfill(status=204)))
    page.on("dialog", lambda dialog: (dialogs.append(dialog.message), dialog.dismiss()))

    def visit(text):
        page.goto("about:blank")
        asked.clear(), dialogs.clear()
        page.evaluate("window.fired = 0")
        page.set_content(text, wait_until="load")
        page.evaluate("document.querySelectorAll('#go').forEach(one => one.click())")
        page.wait_for_timeout(30)
        fired = page.evaluate("window.fired")
        return SimpleNamespace(fired=fired, asked=[*asked], dialogs=[*dialogs], page=page)

    return visit


def unescaped(text):
    """The same page with its words as markup; what loads another page would end the walk."""
    return html.unescape(text).replace(ATTACKS["refresh"], "")


def unmoved(seen):
    return not seen.fired and not seen.asked and not seen.dialogs


# every result in the package, made with hostile names
# ------------------------------------------------------------------


def classes_with_html():
    """Every class of the package that writes HTML, whoever adds it."""
    found = {}
    for module in pkgutil.walk_packages(trustlab.__path__, "trustlab."):
        if module.name.endswith("__main__"):
            continue
        for name, kind in vars(importlib.import_module(module.name)).items():
            if (
                isinstance(kind, type)
                and kind.__module__ == module.name
                and ("_repr_html_" in vars(kind) or Result in kind.__bases__)
                and kind is not Result
            ):
                found[name] = kind
    return found


def scores():
    rng = np.random.default_rng(1)
    rows = [
        {
            f"subject {NAME}": f"{NAME} {i}",
            f"condition {NAME}": f"{NAME} {j}",
            f"score {NAME}": j + rng.normal(),
        }
        for i in range(5)
        for j in range(3)
    ]
    frame = pd.DataFrame(rows)
    frame.attrs.update(reconstructed=True, note=NAME)
    return frame


def session():
    t = np.arange(40) * 0.1
    data = pd.DataFrame({"p_r": np.sin(t)}, index=pd.Index(t, name="t"))
    return Session(data, Metadata(NAME, NAME, NAME, False, {"trial": NAME, "note": NAME}))


class Policy:
    title = NAME

    def leader(self, now):
        return 0


def team():
    graph = nx.relabel_nodes(nx.complete_graph(3), {i: f"{NAME} {i}" for i in range(3)})
    return tl.simulate_team(graph, policy=Policy(), duration=6.0, trial=TeamTrial(0.01))


def virtual_study():
    measures = pd.DataFrame(
        [(i, f"{NAME} {j}", 1.0, i + j) for i in range(4) for j in range(2)],
        columns=["participant", "condition", "position", f"score {NAME}"],
    ).assign(synthetic=True)
    conditions = tuple(measures["condition"].unique())
    return VirtualStudy(
        SimpleNamespace(name="ground_robot", title="a testbed", origin=NAME),
        conditions,
        None,
        measures[["participant"]],
        measures,
        measures[:0],
        {"laps": 1},
        None,
    )


def columns():
    return dict(zip(("subject", "within", "dv"), scores().columns, strict=True))


def late():
    """Results that are dear to compute, made of hostile tables."""
    formula = FormulaModel(NAME, NAME, 5, 15, scores(), scores(), scores(), 0.0, False, 0, NAME)
    tables = dict.fromkeys(("checks", "table", "reach"), lambda self: scores())
    own = type("OwnCalibration", (Calibration,), tables | {"message": NAME})
    calibration = own(
        NAME, {}, scores(), (NAME,), scores(), (NAME,), {"simulations": NAME, "n": NAME}
    )
    return (
        formula,
        calibration,
        report(scores(), **columns()),
        Passivity(pd.DataFrame({NAME: [0.0, -1.0]}), False, False, 12.0),
        *live(),
    )


def live():
    """A live study and what it has recorded, in a folder with a hostile name."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / NAME.replace("/", "")[:200]
        plan = tl.LiveStudy(folder, ["C1", "C3"], participants=2)
        return plan, tl.read_live_study(folder)


def posterior():
    """The posterior of a few minutes, and a population of that person, with hostile names."""
    short = tl.Session(
        tl.read_session(PILOT)
        .data.iloc[11_000:14_000]
        .reset_index(drop=True)
        .set_index(0.1 * np.arange(3000))
    )
    drawn = tl.sample_posterior(short, n=100, window=0)
    drawn = dataclasses.replace(drawn, whiteness={NAME: 0.5})
    people = {NAME: drawn}
    new = drawn.draws[list(MODEL_NAMES)]
    return drawn, Population(people, people, None, np.zeros((2, 7)), new, drawn.prior)


def ordinal():
    """A model of ratings whose tables hold hostile names."""
    frame = scores()
    tests = pd.DataFrame({"term": [NAME], "chi2": 1.0, "df": 1, "p_chi2": 0.3})
    pairs = pd.DataFrame({"a": [NAME], "b": NAME, "p_holm": 0.01, "odds_ratio": 2.0})
    pairs = pairs.assign(ci_low=0.5, ci_high=0.9)
    tables = (tests, *[frame] * 4, pairs, frame)
    return OrdinalModel(NAME, NAME, (1, 2), 5, 15, *tables, 0.0, False, NAME)


def of_trust():
    """A fit and a comparison of models of trust on two people with hostile names."""
    rng = np.random.default_rng(4)
    rows = [
        {"person": f"{NAME} {person}", "trial": k, "p_r": rng.random(), "rating": rng.random()}
        for person in range(3)
        for k in range(8)
    ]
    panel = tl.trust.panel_from_table(pd.DataFrame(rows), source=NAME, cautions=(NAME,))
    fit = tl.fit_trust(panel, "performance", pooling="full")
    scores = pd.DataFrame(1.0, range(4), MEASURES)
    scores = scores.assign(split=NAME, model=["a", NAME] * 2, person=["P1", "P1", "P2", "P2"])
    return fit, TrustComparison(scores, NAME, NAME, (NAME,))


MODEL = tl.published_models()["2"]
STUDY = tl.published_studies()["teleop.tracking_error"]
PILOT = Path(__file__).parents[2] / "data" / "sessions" / "pilot.csv"


def built():
    """One result of each class, with hostile names wherever it takes any."""
    analysis = tl.repeated_measures(scores().drop(index=[0]), missing="listwise", **columns())
    design = tl.latin_square_design(
        [f"{NAME} {i}" for i in range(4)], [f"{NAME} {i}" for i in range(4)]
    )
    labels = [f"{NAME} {i}" for i in range(2)]
    quick = {"simulation": tl.studies.Simulation(replicates=100)}
    choice = dataclasses.replace(tl.choose_thresholds(MODEL, points=4), message=NAME)
    two = scores()[lambda frame: ~frame.iloc[:, 1].str.endswith("2")]
    run = tl.run_condition("C2", participant=2, laps=3)
    flight = team()
    names = columns()
    twice = pd.concat([scores().assign(**{f"trial {NAME}": f"{NAME} {i}"}) for i in range(2)])
    twice[names["dv"]] += np.random.default_rng(2).normal(size=len(twice))
    factorial = tl.repeated_measures(
        twice, **names | {"within": [names["within"], f"trial {NAME}"]}
    )
    orders = design.orders().set_axis(["subject " + NAME, "position", "condition " + NAME], axis=1)
    orders[names["dv"]] = np.random.default_rng(3).normal(size=len(orders))
    order = tl.order_effects(
        orders, names["dv"], names["within"], "position", subject=names["subject"]
    )
    names = [
        "r",
        "p_r",
        "p_h",
        "tsc",
        "mode",
        "suggestion",
        "lower",
        "upper",
        "c_l",
        "c_u",
        "cost",
        "cost_lower_bound",
        "latency",
    ]
    steps = pd.DataFrame(0.5, range(3), names).assign(test=1, t=range(3), status="planned")
    data = reconstruct_study(tl.published_studies()["teleop.tracking_error"])
    left_out = dict.fromkeys(data.table().index, NAME)
    ones = np.eye(2)
    return [
        factorial,
        order,
        analysis,
        analysis.mixed_model(),
        tl.paired_t_test(two, **columns()),
        tl.winsorize(scores(), **columns(), outside="iqr", k=0.1, to="next"),
        Questionnaire(NAME, ["a", NAME], 1, 7, source=NAME),
        ScaleScores(Questionnaire(NAME, [NAME], 1, 7, source=NAME), scores(), {}, scores()[:0]),
        tl.cronbach_alpha(pd.DataFrame({"a": [1, 2, 3], NAME: [1, 3, 2]})),
        design,
        design.balance(),
        virtual_study(),
        tl.power_analysis(dict(zip(labels, (0, 1), strict=True)), ones, n=5, **quick),
        tl.smallest_n(0.5, dict(zip(labels, (0, 3), strict=True)), ones, **quick),
        session(),
        dataclasses.replace(run, metadata=session().metadata),
        ArxResult((NAME, "c"), ones[0], ones, np.ones(9), 1, (1,), (1,), True),
        dataclasses.replace(tl.fit_robot(tl.read_session(PILOT)), message=NAME),
        choice,
        choice.limits,
        choice.cycle,
        choice.bounds,
        RangeIntervals([choice.cycle] * 2, np.array([True, False])),
        tl.feasibility(dataclasses.replace(STUDY, name=NAME), explain=False),
        *of_trust(),
        tl.optimal_allocation(MODEL),
        *posterior(),
        ordinal(),
        tl.steady_state_bounds(MODEL, choice.lower, choice.upper),
        CorrectionRun(steps, (0.1, 0.2), (0.2, 0.3), NAME, NAME),
        dataclasses.replace(data, answer=dataclasses.replace(data.answer, left_out=left_out)),
        flight,
        *late(),
    ]


@pytest.fixture(scope="module")
def results():
    return {type(result).__name__: result for result in built()}


def test_every_class_that_writes_html_is_walked(results):
    """A new result is added to `built`, with hostile names wherever it takes any."""
    walked = {kind.__name__ for result in results.values() for kind in type(result).__mro__}
    assert set(classes_with_html()) - walked == set()
    assert sum("onerror" in result._repr_html_() for result in results.values()) >= 18


def test_results_show_hostile_names_as_words(visit, results):
    for name, result in results.items():
        seen = visit(result._repr_html_())
        assert unmoved(seen), (name, seen)
        found = seen.page.evaluate(
            "document.querySelectorAll('img, script, form, button, meta, link, base, svg').length"
        )
        assert found == 0, name
        assert name != "Session" or NAME in seen.page.evaluate("document.body.textContent")


def test_the_same_results_fire_where_nothing_is_escaped(visit, results):
    seen = visit(unescaped(results["Session"]._repr_html_()))
    assert seen.fired
    assert seen.asked


# reports
# --------------------------------------------------------------------------------------------------


def test_a_table_shows_hostile_names_as_words(visit):
    frame = pd.DataFrame({NAME: [NAME], "n": [1.5]}, index=pd.Index([NAME], name=NAME))
    frame.columns.name = NAME
    seen = visit(table_html(frame))
    assert unmoved(seen), seen
    assert visit(unescaped(table_html(frame))).fired


def test_a_report_shows_what_a_cell_prints_as_words(visit, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    cell = new_code_cell(f"name = {NAME!r}\nprint(name)\nname")
    root = make(tmp_path, n01_a=["# A", cell])
    publish(root)
    assert write_book(root).returncode == 0
    page = (root / "reports" / "01_a.html").read_text()
    body = re.sub(r"<script[^>]*>.*?</script>|<link[^>]*>", "", page, flags=re.S)
    assert "attacker.invalid" in body
    assert visit(body).fired == 0
