"""Small models, sessions, tables and graphs that tests share, each made once per process."""

from dataclasses import replace
from functools import cache

import networkx as nx
import numpy as np
import pandas as pd
import pytest

import trustlab as tl

CORNERS = ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (0.0, 9.0))
THRESHOLDS = {"lower": 0.0, "upper": 0.35}


def refused(words):
    """A block whose call the package must refuse, with an error that says these words."""
    return pytest.raises(ValueError, match=words)


@cache
def model():
    """The printed operator 2, whose thresholds make a limit cycle."""
    return tl.published_models()["2"]


@cache
def driver():
    return tl.testbeds.published_operator(2)


@cache
def drive():
    """Two laps of condition C3 with its suggestions."""
    return tl.run_condition("C3", participant=2, laps=2, seed=0)


@cache
def flight():
    return tl.simulate_teleoperation("TMIG", seed=0, duration=5.0)


@cache
def team():
    return tl.simulate_team(graph(), seed=0, duration=5.0)


@cache
def graph():
    return nx.cycle_graph(4)


@cache
def log():
    """The pilot log at one sample in five seconds, which is enough to fit models to."""
    pilot = tl.read_session("data/sessions/pilot.csv")
    return tl.Session(pilot.data.iloc[::50], pilot.metadata)


@cache
def study():
    """A printed study of two conditions, whose data are found at once."""
    means, sds = {"A": "2.31", "B": "3.05"}, {"A": "0.84", "B": "0.79"}
    return tl.PublishedStudy("mine", n=12, mean=means, sd=sds, t_test={"t": "-3.42"})


@cache
def response():
    """A step of a command and the velocity that follows it with a time constant of 2 s."""
    command = np.repeat([0.0, 1.0, -1.0], 50)
    velocity, noise = np.zeros(150), np.random.default_rng(0).normal(size=150)
    for k in range(149):
        velocity[k + 1] = 0.995 * velocity[k] + 0.005 * command[k]
    return command, velocity + 1e-4 * noise


@cache
def scores():
    """Scores of six subjects in three conditions, long."""
    rng = np.random.default_rng(0)
    rows = pd.MultiIndex.from_product([range(1, 7), list("ABC")], names=["subject", "condition"])
    return pd.DataFrame({"value": rng.normal(size=18)}, index=rows).reset_index()


@cache
def panel():
    """The first four people and events of a published study of trust."""
    people = tl.read_people("hybrid_vr").of(range(4))
    events = tl.trust.Event(*(signal[:, :4] for signal in people.events))
    return replace(people, events=events, ratings=people.ratings[:, :5])


@cache
def scattering():
    return tl.Scattering(b=2.0, alpha_min=0.2, alpha_max=1.0, beta_min=0.05, beta_max=0.5)


def distance(course, x, y):
    """Distances of points from a course: the least of those from all of its pieces."""
    begin, along = course.path[:-1, :2], np.diff(course.path[:, :2], axis=0)
    points = np.column_stack([x, y])[:, None]
    share = ((points - begin) * along).sum(axis=2) / (along**2).sum(axis=1)
    feet = begin + share.clip(0.0, 1.0)[..., None] * along
    return np.sqrt(((points - feet) ** 2).sum(axis=2)).min(axis=1)


# --- the equations of TSC written out, without the package ----------------------------------------


def shape(r, beta):
    """The curve of (2.6), from 0 at the ends to 1 at β."""
    return (r / beta) ** beta * ((1 - r) / (1 - beta)) ** (1 - beta)


def curve(human, r):
    """(2.6) at one utilization."""
    share = shape(r, human.beta) if 0.0 < r < 1.0 else 0.0
    return human.p_min + (human.p_max - human.p_min) * share


def weights(model):
    """a_T and b_T of (2.2)."""
    r, h = model.robot, model.human
    scale = r.p_max * h.p_max - r.p_min * h.p_min
    return (h.p_max + h.p_min) / scale, (r.p_max + r.p_min) / scale


def motion(model, r, p_r, decide):
    """
    (2.1)-(2.6) in plain Python, for ever: r, P_r, P_h, TSC and mode of each sample; what decides
    gives the mode for TSC.
    """
    robot, human, (a_T, b_T) = model.robot, model.human, weights(model)
    while True:
        p_h = curve(human, r)
        tsc = a_T * p_r - b_T * p_h
        mode = decide(tsc)
        yield r, p_r, p_h, tsc, mode
        p_r = robot.a * p_r + (1 - robot.a) * robot.p_min + mode * robot.b * p_h
        r = human.a * r + (1 - human.a) * mode
