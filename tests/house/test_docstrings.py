"""Every exported function, method and class says what it does and documents every argument."""

import inspect
from dataclasses import is_dataclass

import pytest
from numpydoc.docscrape import NumpyDocString

import trustlab as tl

ROOMS = [room for name in tl.__all__ if inspect.ismodule(room := getattr(tl, name))]
THINGS = [getattr(room, name) for room in ROOMS for name in room.__all__]
EXPORTED = {thing.__name__: thing for thing in THINGS if inspect.isroutine(thing)}
EXPORTED |= {thing.__name__: thing for thing in THINGS if inspect.isclass(thing)}


def documented(thing):
    """The names that the docstrings of a function, or of a class and those above it, explain."""
    docs = [
        NumpyDocString(inspect.getdoc(each) or "") for each in getattr(thing, "__mro__", [thing])
    ]
    entries = [entry for doc in docs for entry in [*doc["Parameters"], *doc["Attributes"]]]
    return {name.strip().lstrip("*") for entry in entries for name in entry.name.split(",")}


def undocumented(thing, name):
    """What of a function or class has no docstring, and arguments that its docstring leaves out."""
    if not inspect.getdoc(thing):
        return [name]
    made_by_users = is_dataclass(thing) or "__init__" in vars(thing)
    taken = inspect.isroutine(thing) or (
        made_by_users and not getattr(thing, "_is_protocol", False)
    )
    arguments = set(inspect.signature(thing).parameters) - {"self", "cls"} if taken else set()
    public = {argument for argument in arguments if not argument.startswith("_")}
    faults = [f"{name}({argument})" for argument in public - documented(thing)]
    for own, method in vars(thing).items() if inspect.isclass(thing) else ():
        method = getattr(method, "__func__", method)
        if inspect.isfunction(method) and not own.startswith("_"):
            faults += undocumented(method, f"{name}.{own}")
    return faults


@pytest.mark.parametrize("name", sorted(EXPORTED))
def test_every_public_argument_is_documented(name):
    assert undocumented(EXPORTED[name], name) == []


def test_the_check_sees_what_it_should():
    def scaled(x, factor):
        """
        Scale.

        Parameters
        ----------
        x : float
            A number.
        """

    assert undocumented(scaled, "scaled") == ["scaled(factor)"]
