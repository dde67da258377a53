"""Simulated teams for tests: every option by its name, whichever settings it belongs to."""

from dataclasses import fields, replace

import trustlab as tl
from trustlab.teleoperation import TeamChannel, TeamSettings, TeamTrial


def picked(kind, options):
    """The options that a class of settings has, taken out of `options`."""
    return {item.name: options.pop(item.name) for item in fields(kind) if item.name in options}


def team_loop(graph, policy="most_trusted", goal=(1.0, 2.0, 0.5), seed=0, **options):
    settings = options.pop("settings", TeamSettings())
    options.setdefault("performance", "random")  # theorems hold whoever is trusted
    channel, trial = picked(TeamChannel, options), picked(TeamTrial, options)
    changed = {"channel": TeamChannel(**channel)} | picked(TeamSettings, options)
    options |= {"settings": replace(settings, **changed), "trial": TeamTrial(**trial)}
    return tl.TeamLoop(graph, policy, goal, seed, **options)


def simulate_team(*arguments, **options):
    return team_loop(*arguments, **options).run()
