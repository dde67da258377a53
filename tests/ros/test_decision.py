"""The decision core: oracles are the session's own measures and plain loops over random faults."""

import math

import numpy as np
import pytest
from hypothesis import given, settings as budget, strategies as st

import trustlab as tl
from tests.cases import refused
from trustlab.ros import CoreSettings, RunSettings, Watchdog
from trustlab.ros.core import AllocationCore
from trustlab.sessions.errors import SessionError

MODEL = tl.published_models()["1"]
PERIOD = 0.05
SHORT = CoreSettings(period=PERIOD, window=2.0)


def core_of(condition=None, thresholds=None, rule=None):
    return RunSettings(MODEL, condition, thresholds, rule, settings=SHORT).core()


class Always:
    """A rule that always says the same."""

    def __init__(self, mode):
        self.answer = mode

    def step(self, tsc, p_r):
        return self.answer


class Turns:
    """A rule by which both drive in turn, fifty samples each."""

    def __init__(self):
        self.asked = 0

    def step(self, tsc, p_r):
        self.asked += 1
        return self.asked // 50 % 2


MESSAGES = {
    "odometry": (0.0, 0.0),
    "operator": (0.3, 0.1),
    "autonomy": (0.4, -0.2),
    "path_error": (0.1,),
}


def heard(core, now, values=MESSAGES, silent=()):
    for name in values.keys() - silent:
        core.hear(name, now, values[name], now)


def texts(core):
    return [text for _, text in core.notes]


def drive(core, steps=400):
    rng = np.random.default_rng(0)
    decisions = []
    for k, x in enumerate(rng.uniform(0.0, 0.03, steps).cumsum()):
        values = {
            "odometry": (x, 0.1 * math.sin(x)),
            "operator": (rng.uniform(0, 0.5), rng.normal()),
            "autonomy": (rng.uniform(0, 0.5), rng.normal()),
            "path_error": (abs(rng.normal()),),
        }
        heard(core, k * PERIOD, values)
        decisions.append(core.step(k * PERIOD))
    return decisions


@pytest.mark.parametrize("condition", ["C1", "C2", "C3", "C4", "C5"])
def test_performance_and_tsc_on_line_agree_with_the_log(condition):
    thresholds = (-0.2, 0.3) if condition in ("C2", "C3") else None
    core = core_of(condition, thresholds)
    decisions = drive(core)
    logged = core.session(participant=1)
    again = logged.with_performance(window=SHORT.window, e_max=SHORT.e_max)
    for name in ("p_r", "p_h"):
        assert again[name] == pytest.approx(logged[name], abs=1e-12)
    tsc = MODEL.value(logged["p_r"], logged["p_h"])
    assert logged["tsc"] == pytest.approx(tsc, abs=1e-12)
    for name in ("tsc", "mode"):
        assert [getattr(each, name) for each in decisions] == logged[name].tolist()


def test_utilization_follows_the_mode_at_the_models_own_rate():
    core = core_of(rule=Turns())
    drive(core)
    log = core.session()
    assert 0.0 < log["mode"].mean() < 1.0
    r = 0.0
    for k, mode in enumerate(log["mode"]):  # (2.5) over half of the model's sample time
        assert log["r"][k] == pytest.approx(r, abs=1e-14)
        r = mode + (r - mode) * math.sqrt(MODEL.human.a)


def test_c3_follows_the_thresholds_and_c2_only_suggests():
    by_button = core_of("C1")
    drive(by_button)
    low, high = np.quantile(by_button.session()["tsc"], [0.3, 0.7])
    cores = {c: AllocationCore(MODEL, c, (low, high), None, None, SHORT) for c in ("C2", "C3")}
    for core in cores.values():
        drive(core)
    forced = cores["C3"].session()
    mode, modes = 1, []
    for k, tsc in enumerate(forced["tsc"]):  # (2.8), once the window is full
        if k * PERIOD >= SHORT.window:
            mode = 0 if tsc >= high else 1 if tsc <= low else mode
        modes.append(mode)
    assert forced["mode"].tolist() == modes
    assert set(modes[40:]) == {0, 1}
    advised = cores["C2"].session()
    assert (advised["mode"] == 1.0).all()
    assert set(advised["suggested_mode"]) == {-1.0, 0.0}
    assert cores["C2"].mode == 1
    for core in cores.values():
        core.press(0)
    assert cores["C2"].mode == 0
    assert cores["C3"].mode == forced["mode"][-1]
    assert "button: no effect where a rule allocates" in texts(cores["C3"])


MESSAGE = st.tuples(
    st.sampled_from(["odometry", "operator", "autonomy", "path_error"]),
    st.sampled_from([0.0, 0.0, 0.0, -PERIOD, -0.3, -5.0, 1.0, math.nan]),
    st.one_of(st.floats(-3.0, 3.0), st.sampled_from([math.nan, math.inf, -math.inf, 1e300])),
)


@budget(max_examples=150, deadline=None)
@given(st.lists(st.lists(MESSAGE, max_size=6), min_size=5, max_size=60), st.data())
def test_no_fault_of_messages_leads_to_a_command_outside_the_bounds(ticks, data):
    core = core_of(rule=Always(0))
    s = core.settings
    before = (0.0, 0.0)
    stops = data.draw(st.sets(st.integers(0, len(ticks))))
    for k, messages in enumerate(ticks):
        now = k * PERIOD
        if k in stops:
            core.release() if core.stopped else core.stop()
        for name, offset, value in messages:
            values = (value,) if name == "path_error" else (value, value)
            noted = len(core.notes)
            accepted = core.hear(name, now + offset, values, now)
            assert accepted or len(core.notes) == noted + 1
            bounds = (s.v_max, s.w_max) if name in ("operator", "autonomy") else (math.inf,) * 2
            within = tuple(min(max(v, -b), b) for v, b in zip(values, bounds, strict=False))
            assert not accepted or core.inputs[name].values == within
        d = core.step(now)
        assert abs(d.v) <= s.v_max
        assert abs(d.w) <= s.w_max
        if core.stopped:
            assert (d.v, d.w, d.driver) == (0.0, 0.0, "nobody")
        else:
            assert abs(d.v - before[0]) <= s.v_rate * PERIOD + 1e-12
            assert abs(d.w - before[1]) <= s.w_rate * PERIOD + 1e-12
        before = (d.v, d.w)


def test_a_refused_message_is_named_and_changes_nothing():
    """Faults that messages on their way may have are those of `test_node.py`."""
    core = core_of("C1")
    heard(core, 1.0)
    for stamp, words in ((9.0, "stamp is 7.95 s ahead of the clock"), (math.nan, "stamp is nan")):
        assert not core.hear("operator", stamp, (0.1, 0.1), 1.05)
        assert texts(core)[-1] == f"operator: {words}"
    assert core.inputs["operator"].values == MESSAGES["operator"]


@pytest.mark.parametrize(
    ("silent", "mode", "driver", "share"),
    [
        ({"operator"}, 1, "autonomy", 0.0),
        ({"operator"}, 0.25, "autonomy", 0.0),
        ({"autonomy"}, 0, "operator", 1.0),
        ({"autonomy"}, 0.25, "operator", 1.0),
        ({"operator", "autonomy"}, 1, "nobody", None),
        ({"odometry"}, 1, "nobody", None),
        ({"path_error"}, 1, "operator", 1.0),
        (set(), 1, "operator", 1.0),
        (set(), 0.25, "both", 0.25),
        (set(), 0, "autonomy", 0.0),
    ],
)
def test_a_silent_input_leads_to_the_stated_action_and_shares_blend_both_commands(
    silent, mode, driver, share
):
    core = core_of(rule=Always(mode))
    for k in range(80):
        now = k * PERIOD
        heard(core, now, silent=silent if k > 50 else ())
        d = core.step(now)
    assert (d.driver, d.mode) == (driver, mode)
    assert set(core.session()["mode"]) == {mode, 1.0}  # the operator drives until the window fills
    for name in silent:
        action = core.settings.watchdogs[name].action
        assert f"{name}: silent, {action}" in texts(core)
    blended = (0.0, 0.0) if share is None else (0.4 - 0.1 * share, 0.3 * share - 0.2)
    assert (d.v, d.w) == pytest.approx(blended)
    heard(core, 4.0)
    core.step(4.0)
    assert all(f"{name}: heard again" in texts(core) for name in silent)


def test_clocks_that_go_back_and_late_steps_are_named():
    core = core_of("C1")
    core.step(1.0)
    core.step(1.3)
    assert texts(core) == ["step late: 0.3 s after the one before"]
    core.step(0.5)
    assert texts(core)[-1] == "clock went back by 0.8 s"


def test_bad_settings_and_missing_logs_say_what_to_do():
    with refused("choose_thresholds"):
        RunSettings(MODEL, "C3")
    hold = CoreSettings().watchdogs | {"operator": Watchdog(1.0, "hold")}
    with refused("watchdog of operator must be one of 'hand over', 'stop'"):
        CoreSettings(watchdogs=hold)
    core = core_of("C1")
    core.hear("odometry", 0.0, (0.0, 0.0), 0.0)
    with pytest.raises(SessionError, match="never heard: operator, autonomy, path_error"):
        core.session()
