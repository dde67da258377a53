"""Functions of power, called with their settings by name."""

import dataclasses

from trustlab.studies import Simulation, StudyColumns


def settled(function, *population, **arguments):
    """Call a function of power with its settings by name."""
    for name, kind in (("simulation", Simulation), ("columns", StudyColumns)):
        fields = {field.name for field in dataclasses.fields(kind)} & set(arguments)
        arguments |= {name: kind(**{field: arguments.pop(field) for field in fields})}
    return function(*population, **arguments)
