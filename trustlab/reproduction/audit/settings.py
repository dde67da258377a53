"""The audit of settings: scales, durations, the mean (2.4), the measure Z_Ph, the passivity condition (3.10) and PD gains."""

import numpy as np

from trustlab.reproduction.audit.verdict import Check, Finding, Formula, Numbers, Remark

# Who says how far answers of a study went: both studies have the questionnaire of the one before.
SCALES = {"uav.satisfaction": "section_2_4_1_3/scale", "teleop.satisfaction": "section_3_8_2/scale"}


def _on_the_scale(study: str, numbers: Numbers) -> Check:
    """Return the check that no mean exceeds the greatest answer."""
    means = {id.rpartition(".")[2]: id for id in numbers if id.startswith(f"{study}/mean.")}
    greatest = Formula("greatest mean", means, lambda v: np.maximum.reduce(list(v.values())))
    scale = numbers[SCALES[study]]
    note = f"The dependent variables of {study} are said to be those of the study before, answered from 1 to {scale.printed}."
    return Check(scale.id, greatest, suffix=f"/{study}", target=(1.0, scale.value), note=note)


def _perfect_operator(numbers: Numbers) -> Check:
    """Return the check that nobody who is measured performs better than a perfect operator, u_h = u_i."""
    means = {id.rpartition(".")[2]: id for id in numbers if id.startswith("uav.human_performance/mean.")}
    perfect = Formula("(u_i − u_h)/du_max at u_h = u_i", means, lambda v: np.zeros(()))
    best = max(numbers[id].value for id in means.values())
    note = f"Means up to {best:g} are printed as performance: a quality would be 1 − |u_i − u_h|/du_max."
    return Check("section_2_4_2/Z_Ph", perfect, target=(best, np.inf), note=note)


def _heaviest_handle(section: str, numbers: Numbers) -> Remark:
    """Return a remark on (3.10) at rest, B ≥ M Λ."""
    B, rate = numbers[f"{section}/B"], numbers[f"{section}/Lambda"]
    grams = 1000.0 * B.value / rate.value
    found = f"(3.10) needs B ≥ MΛ: with B = {B.printed} and Λ = {rate.printed} the handle may weigh {grams:.3g} g"
    if grams < 50.0:  # no handle of a haptic device is so light
        return Remark(B.id, f"Suspicious: {found}, less than any that a hand holds; its mass is not printed.")
    return Remark(B.id, f"{found}; its mass is not printed.")


def setting_checks(numbers: Numbers) -> list[Finding]:
    """Return the checks of settings that other printed numbers bear on."""
    minutes = {name: f"section_2_4_2_3/{name}" for name in ("tutorial", "identification", "task")}
    minutes |= {"trials": "section_2_4_2_2/trials"}
    needed = Formula.of("(tutorial + identification + 5 * trials * task) / 60", minutes, "five conditions")
    study = numbers["section_2_4_2_3/study"]
    rest = "The rest is for questionnaires, consent and breaks."
    window = {"W": "section_2_2_2/W", "T": "section_2_2_2/T"}
    terms = Formula.of("(W / T + 1) / (W / T)", window, "W + 1 terms from k − W to k, divided by W")
    ids = {name: f"appendix_a/model/x_{name}" for name in ("gain", "damping", "stiffness")}
    ids |= {"p": "appendix_a/pd/p_xy", "d": "appendix_a/pd/d_xy"}
    margin = Formula.of("damping * (stiffness + gain * d) - gain * p", ids, "Routh: positive where the loop is stable")
    note = "The error rows of Appendix A with α = 0 diverge along x: the autonomous control alone is unstable."
    return [
        *(_on_the_scale(name, numbers) for name in SCALES),
        _perfect_operator(numbers),
        *(_heaviest_handle(section, numbers) for section in ("section_3_8_1", "section_3_9")),
        Check(study.id, needed, target=(0.0, study.value), note=rest),
        Check("section_2_2_2/weights", terms),
        Check("appendix_a/pd/p_xy", margin, suffix="/stable", target=(0.0, np.inf), note=note),
    ]
