"""How hard the live task of the ground robot is, by what scripted hands reach."""

import numpy as np
import pandas as pd

from trustlab.live.hands import Driver, HumanHand, IdealHand
from trustlab.live.task import scripted_commands
from trustlab.live.tasks.ground_robot import TASK, drive_config
from trustlab.models.checks import whole_number
from trustlab.reproduction.published import published_models, published_table


def live_difficulty(seeds: int = 3, laps: int = 2) -> pd.DataFrame:
    """
    Return how hard the live task is: P_r and P_h of scripted hands, driving alone, beside the
    printed people's.

    Parameters
    ----------
    seeds : int
        How many drives of each hand.
    laps : int
        How many laps each; means are over what follows the first 100 s, in which the window of
        (2.4) and (2.7) fills.

    Returns
    -------
    pandas.DataFrame
        Columns who, source ("simulated" or "printed"), p_r, p_h [m/s] and path_error [m]. The
        printed rows are the means of Table 2.5, C1 to C5, in which the robot drives a part of the
        time, and the participants' P_r,max and P_h,max of Table 2.1.

    Raises
    ------
    ValueError
        If a number is not whole and positive.
    """
    seeds, laps = whole_number("seeds", seeds), whole_number("laps", laps, least=2)
    rows = []
    for kind in (IdealHand, HumanHand):
        for seed in range(seeds):
            config = drive_config("training", laps=laps, seed=seed)
            hand = kind(config, seed) if kind is HumanHand else kind(config)
            late = 0.0 if kind is IdealHand else config["late"]
            _, made = scripted_commands(TASK, config | {"late": late}, Driver(config, hand))
            data = TASK.session(config, made).data
            rows.append(
                (kind.__name__, "simulated", *data.loc[100.0:, ["p_r", "p_h", "path_error"]].mean())
            )
    columns = ["who", "source", "p_r", "p_h", "path_error"]
    hands = (
        pd.DataFrame(rows, columns=columns)
        .groupby(["who", "source"], sort=False, as_index=False)
        .mean()
    )
    table, models = published_table("2.5"), published_models()
    means = table[["P_r_mean", "P_h_mean"]].astype(float)
    printed = [(f"people, {c}", "printed", p_r, p_h, np.nan) for c, p_r, p_h in means.itertuples()]
    best = [
        (f"participant {n}", "printed", models[n].robot.p_max, models[n].human.p_max, np.nan)
        for n in "12345"
    ]
    return pd.concat([hands, pd.DataFrame(printed + best, columns=columns)], ignore_index=True)
