"""
Simulated operators at the haptic device: their ranges, their grades, and the assumption behind
their answers.
"""

from dataclasses import fields

import numpy as np
import pytest

import trustlab as tl
from trustlab.operators.answers import experience, simulated_answers
from trustlab.operators.teleoperator import RANGES, Teleoperator
from trustlab.sessions.session import Metadata, Session
from trustlab.teleoperation import Guidance
from trustlab.testbeds import TeleoperatorPopulation
from trustlab.testbeds.uav_tracking import TrackingTask

RUN = tl.simulate_teleoperation("TMIG", seed=1, duration=20.0)
# No force on the hand, and nothing that guards it.
FREE = Guidance(guard="off", force=lambda state: (0.0, 0.0, 0.0))


def test_defaults_are_the_middle_of_the_ranges():
    average = Teleoperator()
    for name, ends in RANGES.items():
        assert getattr(average, name) == pytest.approx(np.mean(ends)), name


def test_numbers_are_the_operators_own():
    numbers = Teleoperator(reaction=0.3, lag=0.2, patience=2.0).numbers(0.01, 0.1)
    assert numbers["delay"] == 40
    assert numbers["decay"] == pytest.approx(np.exp(-0.05))
    assert numbers["patience"] == 200


@pytest.mark.parametrize(
    "name", [item.name for item in fields(Teleoperator) if item.name not in ("participant", "law")]
)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_bad_numbers_are_refused(name, bad):
    with pytest.raises(ValueError, match=name):
        Teleoperator(**{name: bad})


def test_allocating_by_hand_costs_a_share_of_the_command_in_mmi_alone():
    costly = Teleoperator(allocation_cost=0.25)
    weaker = Teleoperator(compensation=0.75)
    for scheme, same in (("MMI", weaker), ("M", Teleoperator())):
        runs = [tl.simulate_teleoperation(scheme, who, duration=10.0) for who in (costly, same)]
        assert runs[0].data.equals(runs[1].data), scheme


def test_a_hand_tires_with_what_it_has_pushed():
    """Oracle: the law and the sum of forces, sample by sample."""
    who = Teleoperator(fatigue=2.0, noise=0.0)
    loop = tl.TeleoperationLoop("M", who, seed=3)
    decay, pushed, wish = np.exp(-0.01 / who.lag), 0.0, np.zeros(3)
    for _ in range(400):
        before = loop.state.copy()
        seen = who.proportional * before.seen
        if before.sees:
            seen = seen + who.derivative * (before.seen - before.seen_before) / 0.01
        pushed += 0.01 * np.linalg.norm(before.f_h)
        strength = 1.0 / (1.0 + who.fatigue / 60.0 * pushed)
        wish = decay * wish + (1.0 - decay) * strength * np.clip(seen, -who.reach, who.reach)
        np.testing.assert_allclose(loop.step().wish, wish, rtol=1e-10, atol=1e-15)
    assert strength < 0.95


def test_assumptions_about_teleoperators():
    population = TeleoperatorPopulation("main")
    plain = population.draw(60, seed=1)
    assert set(plain["law"]) == {"proportional"}
    assumptions = {"adapting": 0.4, "gain": 1.5, "crossover": 0.8, "lag": 0.1, "compensation": 2.0}
    assumptions |= {"allocation_cost": 0.3, "fatigue_of_hand": 0.2}
    changed = population.draw(60, seed=1, assumptions=assumptions)
    assert 10 <= (changed["law"] == "crossover").sum() <= 38
    for name, factor in (("proportional", 1.5), ("derivative", 1.5), ("crossover", 0.8)):
        np.testing.assert_allclose(changed[name], factor * plain[name], rtol=1e-12)
    np.testing.assert_allclose(changed["lag"], plain["lag"] + 0.1, rtol=1e-12)
    person = population.person(changed.iloc[5].to_dict())
    assert (person.compensation, person.allocation_cost, person.fatigue) == (2.0, 0.3, 0.2)
    # who adapts at a lower share does so at a higher one
    fewer = population.draw(60, seed=1, assumptions={"adapting": 0.2})["law"] == "crossover"
    assert (changed["law"][fewer] == "crossover").all()
    with pytest.raises(ValueError, match="an assumption must be one of 'adapting'"):
        population.draw(2, assumptions={"attention_cost": 0.1})
    with pytest.raises(ValueError, match="gain"):
        population.draw(2, assumptions={"gain": 9.0})


def stepped(loop, count):
    """The states before each of so many samples."""
    states = []
    for _ in range(count):
        states.append(loop.state.copy())
        loop.step()
    return states


class TestSight:
    """
    What the operator sees, against the logged path; T = 0.01 s, reaction 0.25 s and camera 0.1 s:
    35 samples.
    """

    TASK = TrackingTask(failure_every=1e9)
    LATE = 35

    @pytest.mark.parametrize("preview", [0.0, 0.35, 1.0])
    def test_preview_shows_the_path_ahead(self, preview):
        loop = tl.TeleoperationLoop("M", Teleoperator(preview=preview), seed=4, task=self.TASK)
        states, run = stepped(loop, 300), loop.session.data
        ahead = round(preview / 0.01)
        for k in (100, 180):
            path, robot = (
                run[[f"{name}_{axis}" for axis in "xyz"]].to_numpy()
                for name in ("reference", "robot")
            )
            expected = path[k - self.LATE + ahead] - robot[k - self.LATE]
            np.testing.assert_allclose(states[k].seen, expected, atol=1e-12)

    def test_a_target_that_leaves_the_picture_is_lost_to_eye_and_controller(self):
        task = TrackingTask(failure_every=1e9, view=0.1, integral=0.0)
        loop = tl.TeleoperationLoop(
            "MI", seed=4, duration=30.0, task=task, signals={"push": np.full((3000, 3), 2.0)}
        )
        states, run = stepped(loop, 3000), loop.session.data
        error = (
            run[["reference_x", "reference_y"]].to_numpy() - run[["robot_x", "robot_y"]].to_numpy()
        )
        inside = (np.abs(error) <= 0.1).all(axis=1)
        assert 100 < inside.sum() < 2900, inside.sum()
        for k in range(self.LATE + 1, 3000, 7):
            assert states[k].sees == inside[k - self.LATE], k
            assert states[k].finds == inside[k - 10], k
            if not inside[k - self.LATE]:
                last = np.flatnonzero(inside[: k - self.LATE + 1])[-1]
                np.testing.assert_allclose(states[k].seen[:2], error[last], atol=1e-12)
            if not inside[k - 10]:
                np.testing.assert_array_equal(states[k].u_a, 0.0)
        wide = tl.simulate_teleoperation(
            "MI", Teleoperator(), seed=4, duration=30.0, task=self.TASK
        )
        assert wide["path_error"].max() < 1.0  # negative control: nobody loses anything


class TestCompensation:
    def test_it_scales_what_the_hand_does(self):
        """
        Oracle: without noise, force or delay of the channel the device is linear in what is wanted.
        """
        loops = [
            tl.TeleoperationLoop(
                "M",
                Teleoperator(compensation=factor, noise=0.0),
                seed=2,
                delay=0.0,
                task=TrackingTask(failure_every=1e9),
                guidance=FREE,
            )
            for factor in (1.0, 1.5)
        ]
        one, more = (stepped(loop, 60) for loop in loops)
        for plain, scaled in zip(
            one[36:38], more[36:38], strict=True
        ):  # the first pictures, of the same path
            np.testing.assert_allclose(scaled.wanted, 1.5 * plain.wanted, rtol=1e-9)
            assert np.abs(plain.wanted).max() > 0.0

    @pytest.mark.parametrize("alpha", [0.3, 1.0])
    def test_who_adapts_keeps_the_crossover(self, alpha):
        """
        The gain from the error seen to what the robot is told: ω_c whatever α, where a fixed gain
        is scaled by the channel.
        """
        gains = {}
        for law in ("crossover", "proportional"):
            person = Teleoperator(
                law=law, crossover=0.8, proportional=0.8, derivative=0.0, noise=0.0, reach=5.0
            )
            run = tl.simulate_teleoperation(
                "M",
                person,
                seed=6,
                duration=110.0,
                delay=0.0,
                signals={"alpha": np.full(11_000, alpha)},
                guidance=FREE,
            )
            # what is seen is the error, late by 35 samples
            reference, robot, told = (
                np.column_stack([run[f"{name}_{axis}"] for axis in "xy"])
                for name in ("reference", "robot", "r_s")
            )
            error = reference - robot
            gains[law] = float(np.sqrt(np.mean(told[6000:] ** 2) / np.mean(error[5965:-35] ** 2)))
        assert gains["crossover"] == pytest.approx(0.8, rel=0.15)  # less what lag and device take
        assert gains["proportional"] < 0.7 * gains["crossover"]


def test_skill_makes_a_difference_to_who_adapts():
    """
    Mean error of the third of least and of most skill; with fixed gains reaction and lag alone
    change next to nothing.
    """
    population = TeleoperatorPopulation("main")
    drawn = population.draw(16, seed=1, assumptions={"adapting": 1.0}).sort_values("skill")
    assert set(drawn["law"]) == {"crossover"}
    errors = [
        tl.simulate_teleoperation("M", population.person(one), seed=i, duration=60.0)["path_error"]
        for i, one in enumerate(drawn.to_dict("records"))
    ]
    assert np.mean(errors[-4:]) < 0.9 * np.mean(errors[:4])


def made(error, force, alpha, p_h, p_r, condition="TMIG"):
    """A session with constant signals, so that what was gone through is known in closed form."""
    import pandas as pd

    values = {
        "path_error": error,
        "f_h_x": force,
        "f_h_y": 0.0,
        "f_h_z": 0.0,
        "alpha": alpha,
        "p_h": p_h,
        "p_r": p_r,
    }
    data = pd.DataFrame(
        {name: np.full(50, value) for name, value in values.items()}, index=0.1 * np.arange(50)
    )
    data.index.name = "t"
    return Session(data, Metadata(1, condition, "made", True, {}))


def test_experience_in_closed_form():
    # main study: error range 3 m, holding force K/Λ + β_max b = 2 + 1 N, α in [0.2, 1]
    felt = experience(made(0.6, 3.0, 0.6, 0.3, 0.9))
    assert felt["error"] == pytest.approx(0.2)
    assert felt["effort"] == pytest.approx(0.5)
    assert felt["agreement"] == pytest.approx(1.0 - abs(0.5 - 0.25))
    assert experience(made(30.0, 0.0, 1.0, 0.0, 0.0)) == pytest.approx(
        {"error": 1.0, "effort": 0.0, "agreement": 0.5}
    )


def test_answers_follow_what_was_gone_through():
    calm, rough = made(0.1, 0.1, 0.6, 0.5, 0.5), made(2.5, 20.0, 0.2, 0.9, 0.1)
    low, high = simulated_answers(calm), simulated_answers(rough)
    for name in ("mental", "physical", "temporal", "performance", "effort", "frustration"):
        assert high[name] > low[name] + 20
        assert low[name] % 5 == high[name] % 5 == 0
    for name in ("satisfaction", "comfort", "control", "trust"):
        assert high[name] < low[name] - 1
    assert 1 <= high["trust"] <= low["trust"] <= 7


def test_answers_are_a_persons_own_and_repeatable():
    assert simulated_answers(RUN, participant=3, seed=1) == simulated_answers(
        RUN, participant=3, seed=1
    )
    assert simulated_answers(RUN, participant=3, seed=1) != simulated_answers(
        RUN, participant=4, seed=1
    )
    assert (
        max(
            simulated_answers(RUN, points=5)[name]
            for name in ("satisfaction", "comfort", "control")
        )
        <= 5
    )
