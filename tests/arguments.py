"""
Put one value after another into each argument of a call, and say what came out that should not.

One test walks through all arguments of a call: as thousands of tests, pytest's own work took ten
times as long as the calls.
"""

import dataclasses

from trustlab.studies import Simulation, StudyColumns


def faults(call, good, values, *, never=False, free=()):
    """
    Return a line for each value that an argument answers with anything but an answer or a clear
    ValueError.

    With `never`, an answer is a fault as well. `free` are pairs of an argument and a type of values
    that are not tried.
    """
    found = []
    for argument in good:
        for value in values:
            if any(argument == name and isinstance(value, kind) for name, kind in free):
                continue
            try:
                call(**good | {argument: value})
                fault = "is taken" if never else None
            except ValueError as error:
                fault = None if len(str(error)) > 15 else f"is refused without a reason: {error!r}"
            except Exception as error:  # the fault that is looked for, so that the walk goes on
                fault = f"raises {error!r}"
            if fault:
                found.append(f"{argument} = {value!r:.60} {fault}")
    return found


def settled(function, *population, **arguments):
    """Call a function of power with its settings by name."""
    for name, kind in (("simulation", Simulation), ("columns", StudyColumns)):
        fields = {field.name for field in dataclasses.fields(kind)} & set(arguments)
        arguments |= {name: kind(**{field: arguments.pop(field) for field in fields})}
    return function(*population, **arguments)
