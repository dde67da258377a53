"""Models of trust in the loop of teleoperation: their course on the performance that was logged."""

import numpy as np
import pytest

import trustlab as tl
from trustlab.trust.dynamics import MODELS


@pytest.mark.parametrize("name", ["asymmetric", "beta", "optimo"])
def test_trust_in_the_loop_is_the_models_on_the_loops_performance(name):
    model = MODELS[name]()
    driver = tl.trust.TrustInLoop(model, every=0.5, start=0.4)
    run = tl.TeleoperationLoop("TMIG", trust=driver, seed=0).run(4.0)
    signals = run.signals if hasattr(run, "signals") else run.data
    p_r, trust = np.asarray(signals["p_r"]), np.asarray(signals["trust_hr"])
    belief = model.start(np.array([0.4]))
    trials = len(p_r) // 50
    for k in range(trials - 1):
        p = np.clip(p_r[50 * k : 50 * (k + 1)], 0.0, 1.0).mean()
        belief = model.step(belief, tl.trust.Event(p_r=np.array([p])))
        expected = np.clip(model.rating(belief).mean[0], 0.0, 1.0)
        assert trust[50 * (k + 1) + 2] == pytest.approx(expected, abs=0.02)
    assert np.ptp(trust) > 0.01


def test_two_loops_do_not_share_their_memory():
    driver = tl.trust.TrustInLoop(MODELS["asymmetric"](), every=0.1)
    runs = [tl.TeleoperationLoop("TMIG", trust=driver, seed=0).run(1.0) for _ in range(2)]
    assert runs[0] == runs[1]


def test_a_bare_model_is_one_trial_a_second():
    model = MODELS["asymmetric"]()
    bare = tl.TeleoperationLoop("TMIG", trust=model, seed=0).run(2.5)
    assert bare == tl.TeleoperationLoop("TMIG", trust=tl.trust.TrustInLoop(model), seed=0).run(2.5)
    assert bare != tl.TeleoperationLoop("TMIG", seed=0).run(2.5)


def test_bad_settings_are_named():
    with pytest.raises(ValueError, match="every must be positive"):
        tl.trust.TrustInLoop(MODELS["beta"](), every=0.0)
