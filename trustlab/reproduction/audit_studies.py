"""The audit of the eleven printed studies: degrees of freedom, p-values, effect sizes, sphericity and duplicates."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy import stats

from trustlab.reproduction.audit_checks import Check, Formula, Numbers, Possible, Remark
from trustlab.reproduction.audit_numbers import CONDITIONS
from trustlab.reproduction.audit_pairs import pair_checks

__all__ = ["study_checks", "study_names"]


def study_names(numbers: Numbers) -> list[str]:
    """
    Return the names of the printed studies, for example "uav.tlx".

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    return [id.removesuffix("/n") for id in numbers if id.endswith("/n")]


def mauchly_p(chi2: np.ndarray, n: np.ndarray, k: int) -> np.ndarray:
    """
    Return Mauchly's p with the second-order term of Box's approximation.

    Parameters
    ----------
    chi2 : array_like
        Mauchly's χ².
    n : array_like
        Subjects.
    k : int
        Conditions.
    """
    p, df = k - 1, k * (k - 1) / 2 - 1
    rho = 1.0 - (2 * p * p + p + 2) / (6.0 * p * (n - 1.0))
    weight = (p + 2) * (p - 1) * (p - 2) * (2 * p**3 + 6 * p * p + 3 * p + 2)
    weight = weight / (288.0 * ((n - 1.0) * p * rho) ** 2)
    first = stats.chi2.sf(chi2, df)
    return first + weight * (stats.chi2.sf(chi2, df + 4) - first)


def chi2_of_epsilon(epsilon: np.ndarray, n: np.ndarray, k: int, most: bool) -> np.ndarray:
    """
    Return the least or greatest χ² of Mauchly that an ε of Greenhouse and Geisser leaves.

    W = ∏λ/(mean λ)^p and ε = (Σλ)²/(p Σλ²) of the same p = k − 1 eigenvalues; at given ε, W is extreme where all but one
    eigenvalue are equal, or one is 0.

    Parameters
    ----------
    epsilon, n : array_like
        ε and the number of subjects.
    k : int
        Conditions.
    most : bool
        The greatest χ² instead of the least.
    """
    p = k - 1
    rho = 1.0 - (2 * p * p + p + 2) / (6.0 * p * (n - 1.0))
    spread = np.sqrt(np.maximum(p / np.minimum(epsilon, 1.0) - p, 0.0) * (p - 1.0) / p)
    single = 1.0 - spread if most else 1.0 + spread
    others = (p - single) / (p - 1.0)
    with np.errstate(all="ignore"):
        w = np.where((single > 0.0) & (others > 0.0), single * others ** (p - 1.0), 0.0)
        return -(n - 1.0) * rho * np.log(w)


def _anova(name: str, numbers: Numbers, k: int) -> list:
    at = {key: f"{name}/anova.{key}" for key in ("df1", "df2", "F", "p", "eta2")} | {"n": f"{name}/n"}
    corrected = f"{name}/epsilon" in numbers

    def pick(*keys: str) -> dict[str, str]:
        return {key: at[key] for key in keys}

    checks = [
        Check(
            at["p"],
            Formula(
                "P(F(df1, df2) > F)",
                pick("F", "df1", "df2"),
                lambda v: stats.f.sf(v["F"], v["df1"], v["df2"]),
            ),
        ),
        Check(
            at["eta2"],
            Formula(
                "F/(F + n − 1)", pick("F", "n"), lambda v: v["F"] / (v["F"] + v["n"] - 1.0), "partial η²"
            ),
            (
                Formula(
                    "F df1/(F df1 + df2)",
                    pick("F", "df1", "df2"),
                    lambda v: v["F"] * v["df1"] / (v["F"] * v["df1"] + v["df2"]),
                    "partial η² with the printed df",
                ),
            ),
        ),
    ]
    if corrected:
        at["ε"] = f"{name}/epsilon"
        by_epsilon = Formula(f"{k - 1} ε", pick("ε"), lambda v: (k - 1.0) * v["ε"])
        by_n = Formula("df2/(n − 1)", pick("df2", "n"), lambda v: v["df2"] / (v["n"] - 1.0))
        checks += [
            Check(at["df1"], by_n, (by_epsilon,)),
            Check(
                at["df2"],
                Formula(f"{k - 1} ε (n − 1)", pick("ε", "n"), lambda v: (k - 1.0) * v["ε"] * (v["n"] - 1.0)),
                (Formula("df1 (n − 1)", pick("df1", "n"), lambda v: v["df1"] * (v["n"] - 1.0)),),
            ),
            Check(
                at["ε"],
                Formula(
                    f"df2/({k - 1} (n − 1))",
                    pick("df2", "n"),
                    lambda v: v["df2"] / ((k - 1.0) * (v["n"] - 1.0)),
                ),
                (Formula(f"df1/{k - 1}", pick("df1"), lambda v: v["df1"] / (k - 1.0)),),
            ),
        ]
    else:
        checks += [
            Check(at["df1"], Formula(f"k − 1, k = {k}", {}, lambda v: np.array(k - 1.0))),
            Check(
                at["df2"],
                Formula(f"(k − 1)(n − 1), k = {k}", pick("n"), lambda v: (k - 1.0) * (v["n"] - 1.0)),
            ),
        ]
    return [*checks, _f_ratio(name, numbers, k)]


def _f_ratio(name: str, numbers: Numbers, k: int):
    """Return the range of F that means and SDs leave: correlations from −1/(k − 1) on average to 1."""
    conditions = CONDITIONS[name.split(".")[0]]
    if any(f"{name}/mean.{c}" not in numbers for c in conditions):
        return Remark(f"{name}/anova.F", "The mean and SD of one condition are not printed.")
    inputs = {f"M_{c}": f"{name}/mean.{c}" for c in conditions} | {
        f"SD_{c}": f"{name}/sd.{c}" for c in conditions
    }
    inputs["n"] = f"{name}/n"

    def f_ratio(v: dict, most: bool) -> np.ndarray:
        means = np.stack([v[f"M_{c}"] for c in conditions])
        sds = np.stack([v[f"SD_{c}"] for c in conditions])
        variance = (sds**2).mean(axis=0)
        covariance = (sds.sum(axis=0) ** 2 - (sds**2).sum(axis=0)) / (k * (k - 1.0))
        error = variance - covariance if most else variance * k / (k - 1.0)
        return v["n"] * means.var(axis=0, ddof=1) / error

    return Possible(
        f"{name}/anova.F",
        Formula("F at the least average correlation, −1/(k − 1)", inputs, lambda v: f_ratio(v, False)),
        Formula("F at correlations of 1", inputs, lambda v: f_ratio(v, True)),
    )


def _mauchly(name: str, numbers: Numbers, k: int) -> list:
    at = {key: f"{name}/mauchly.{key}" for key in ("chi2", "df", "p")}
    word = numbers[f"{name}/sphericity"].printed
    target = (0.05, 1.0) if word == "met" else (0.0, 0.05)
    n, epsilon = {"n": f"{name}/n"}, f"{name}/epsilon"
    least, most = (
        Formula(
            f"{'greatest' if top else 'least'} χ² at this ε",
            {"ε": epsilon} | n,
            lambda v, top=top: chi2_of_epsilon(v["ε"], v["n"], k, top),
        )
        for top in (False, True)
    )
    if at["chi2"] not in numbers:
        low, high = least.range(numbers)[1], most.range(numbers)[2]
        span = f"ε = {numbers[epsilon].printed} leaves χ² from {low:.1f} to {high:.1f}, that is p from "
        p = [float(mauchly_p(x, numbers[f"{name}/n"].value, k)) for x in (high, low)]
        return [
            Remark(
                f"{name}/sphericity",
                f"χ² is not printed; {span}{p[0]:.2g} to {p[1]:.2g}.",
            )
        ]
    df = Formula(f"k(k − 1)/2 − 1, k = {k}", {}, lambda v: np.array(k * (k - 1) / 2 - 1.0))
    plain = Formula(
        "P(χ²(df) > χ²)",
        {"χ2": at["chi2"], "df": at["df"]},
        lambda v: stats.chi2.sf(v["χ2"], v["df"]),
        "first-order approximation",
    )
    second = Formula(
        "P(χ²(df) > χ²) + ω [P(χ²(df + 4) > χ²) − P(χ²(df) > χ²)]",
        {"χ2": at["chi2"]} | n,
        lambda v: mauchly_p(v["χ2"], v["n"], k),
        "second-order approximation, as statistical packages give it",
    )
    chi2 = (
        Possible(at["chi2"], least, most)
        if epsilon in numbers
        else Remark(at["chi2"], "Depends on correlations, which are not printed.")
    )
    return [
        Check(at["df"], df),
        Check(at["p"], second, (plain,)),
        Check(
            f"{name}/sphericity",
            Formula("p", {"p": at["p"]}, lambda v: v["p"]),
            target=target,
            note="Sphericity is rejected below 0.05.",
        ),
        chi2,
    ]


def _t_test(name: str, numbers: Numbers) -> list:
    a, b = (id.split(".")[-1] for id in numbers if id.startswith(f"{name}/mean."))
    inputs = {f"M_{c}": f"{name}/mean.{c}" for c in (a, b)} | {f"SD_{c}": f"{name}/sd.{c}" for c in (a, b)}
    inputs["n"] = f"{name}/n"

    def t_value(v: dict, sign: float) -> np.ndarray:
        sd = np.abs(v[f"SD_{a}"] + sign * v[f"SD_{b}"])
        return np.abs(v[f"M_{a}"] - v[f"M_{b}"]) * np.sqrt(v["n"]) / sd

    return [
        Check(
            f"{name}/t_test.p",
            Formula(
                "2 P(t(n − 1) > t)",
                {"t": f"{name}/t_test.t", "n": f"{name}/n"},
                lambda v: 2.0 * stats.t.sf(v["t"], v["n"] - 1.0),
            ),
        ),
        Possible(
            f"{name}/t_test.t",
            Formula("t at a correlation of −1", inputs, lambda v: t_value(v, 1.0)),
            Formula("t at a correlation of 1", inputs, lambda v: t_value(v, -1.0)),
        ),
    ]


def _sample_size(name: str) -> Check:
    chapter = name.split(".")[0]
    section = "section_2_4_2_2" if chapter == "uav" else "section_3_9_2"
    inputs = {"participants": f"{section}/participants", "dropped": f"{section}/dropped"}
    text, compute = "participants − dropped", lambda v: v["participants"] - v["dropped"]
    if chapter == "uav":
        inputs["trials"] = f"{section}/trials"
        text = "trials (participants − dropped)"
        compute = lambda v: v["trials"] * (v["participants"] - v["dropped"])  # noqa: E731
    return Check(
        f"{name}/n",
        Formula(text, inputs, compute),
        note="Trials of one person are counted as if they were of different people."
        if chapter == "uav"
        else "",
    )


def _duplicates(numbers: Numbers, names: list[str]) -> list:
    """Remark on statistics that two studies share to the last digit."""
    checks = []
    for first, second in combinations(names, 2):
        same = [
            key
            for key in ("mauchly.chi2", "mauchly.p", "anova.F")
            if f"{first}/{key}" in numbers
            and f"{second}/{key}" in numbers
            and numbers[f"{first}/{key}"].printed == numbers[f"{second}/{key}"].printed
        ]
        if "mauchly.chi2" in same and "mauchly.p" in same:
            chi2, df = numbers[f"{second}/mauchly.chi2"], numbers[f"{second}/mauchly.df"]
            chance = float(np.diff(stats.chi2.cdf(chi2.compatible, df.value))[0])
            checks.append(
                Remark(
                    f"{second}/mauchly.chi2",
                    f"Suspicious: χ² = {chi2.printed} and p = {numbers[f'{second}/mauchly.p'].printed} are printed for "
                    f"{first} as well; under sphericity two measures agree so closely with a chance of about 1 in "
                    f"{1.0 / chance:.0f}. Probably one was copied from the other.",
                    suffix="/duplicate",
                    quantity=f"{chi2.quantity}, against {first}",
                )
            )
        if "anova.F" in same:
            checks.append(
                Remark(
                    f"{second}/anova.F",
                    f"Suspicious: the same F is printed for {first}.",
                    suffix="/duplicate",
                )
            )
    return checks


def study_checks(numbers: Numbers) -> list:
    """
    Return the checks of every printed study but those of its means and SDs.

    Parameters
    ----------
    numbers : mapping of str to PrintedNumber
        All printed numbers.
    """
    checks, names = [], study_names(numbers)
    for name in names:
        k = len(CONDITIONS[name.split(".")[0]])
        checks.append(_sample_size(name))
        if f"{name}/t_test.t" in numbers:
            checks += _t_test(name, numbers)
        else:
            checks += _anova(name, numbers, k) + _mauchly(name, numbers, k) + pair_checks(name, numbers, k)
    return checks + _duplicates(numbers, names)
