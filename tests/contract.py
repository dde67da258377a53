"""
One walk over the arguments of every public name: bad values, other values, and what comes of them.

The good call is the one in the docstring's example, or one of `tests/good_calls.py`. Each argument
in turn gets the values that its annotation and its good value suggest. The package must answer, or
raise an error of its own that names an argument; and an argument must make a difference.
"""

import copy
import doctest
import inspect
import io
import linecache
import math
import os
import re
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Mapping
from contextlib import nullcontext, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import trustlab as tl
from tests.good_calls import ALLOWED, CALLS, CHEAPER, NOT_WALKED

ROOT = Path(__file__).parents[1]
PACKAGE = str(Path(tl.__file__).parent)
LIMIT = 10.0  # seconds that a call may take
COMPILED = 120.0  # and the first, which may compile


class Hang(BaseException):
    """A call took longer than its limit. No Exception, so that the call cannot catch it."""


class Recorded(BaseException):
    """An example has come to the call that was looked for."""


# Good calls.


@dataclass
class Call:
    """A public function and the arguments of a call that works, by name."""

    name: str
    function: object
    arguments: dict
    folder: "Scratch"
    maker: "Call" = None  # makes the object whose method this is, new for every call
    made: object = None  # what the good call gave

    @property
    def parameters(self):
        return inspect.signature(self.function).parameters

    def annotation(self, argument):
        parameter = self.parameters.get(argument)
        unknown = parameter is None or parameter.annotation is parameter.empty
        return "Any" if unknown else inspect.formatannotation(parameter.annotation)

    def answer(self, **changes):
        self.folder.restore()
        arguments = {name: copied(value) for name, value in self.arguments.items()} | changes
        if self.maker:
            arguments["self"] = self.maker.answer()
        first = [
            arguments.pop(name)
            for name, parameter in self.parameters.items()
            if parameter.kind is parameter.POSITIONAL_ONLY
        ]
        return self.function(*first, **arguments)


def copied(value):
    """Return a deep copy, as calls may change it; of what cannot be copied, the value itself."""
    try:
        return copy.deepcopy(value)
    except (TypeError, RecursionError):
        return value


class Scratch:
    """A folder where examples read `data/` and write; every call finds it in the same state."""

    def __init__(self, folder):
        self.here, self.backup = folder / "here", folder / "backup"
        self.here.mkdir()
        (self.here / "data").symlink_to(ROOT / "data")

    def state(self):
        return {(path, path.lstat().st_mtime_ns) for path in self.here.rglob("*")}

    def keep(self):
        shutil.rmtree(self.backup, ignore_errors=True)
        shutil.copytree(self.here, self.backup, symlinks=True)
        self.kept = self.state()

    def restore(self):
        if self.state() != self.kept:
            shutil.rmtree(self.here)
            shutil.copytree(self.backup, self.here, symlinks=True)
            os.chdir(self.here)
            self.kept = self.state()


def by_name(function, args, kwargs):
    """Return the arguments of a call by name, with defaults, and keywords of `**options` beside."""
    signature = inspect.signature(function)
    bound = signature.bind(*args, **kwargs)
    bound.apply_defaults()
    arguments = dict(bound.arguments)
    for name, parameter in signature.parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            arguments |= arguments.pop(name)
        elif parameter.kind is parameter.VAR_POSITIONAL:
            del arguments[name]
    for name, field in getattr(function, "__dataclass_fields__", {}).items():
        if repr(arguments.get(name)) == "<factory>":
            arguments[name] = field.default_factory()
    return arguments


def recorded(owner, name, documented):
    """Return the arguments with which an example calls `owner.name`, or None where it does not."""
    function, calls = getattr(owner, name), []

    def recorder(*args, **kwargs):
        calls.append(by_name(function, args, kwargs))
        raise Recorded

    examples = doctest.DocTestParser().get_examples(inspect.getdoc(documented) or "")
    source = "".join(example.source for example in examples)
    if f"{name}(" not in source:
        return None
    scope = vars(sys.modules[documented.__module__]) | {"__name__": "__main__"}
    if scope.get(name) is function:
        scope[name] = recorder
    with (
        mock.patch.object(owner, name, recorder),
        # A folder of the example must not be deleted when the recorder leaves its `with`.
        mock.patch("tempfile.TemporaryDirectory", return_value=nullcontext(tempfile.mkdtemp())),
        redirect_stdout(io.StringIO()),
        suppress(Recorded),
    ):
        exec(compile(source, f"<example of {name}>", "exec"), scope)
    return calls[0] if calls else None


def names():
    """Return the names to walk over and where they are: all of `trustlab`, and those of rooms that
    users call.
    """
    rooms = {name: getattr(tl, name) for name in tl.__all__ if inspect.ismodule(getattr(tl, name))}
    places = {name: (tl, name) for name in tl.__all__ if name not in rooms}
    for room, module in rooms.items():
        more = [name for name in module.__all__ if name not in places]
        places |= {f"{room}.{name}": (module, name) for name in more}
    return {
        key: (owner, name)
        for key, (owner, name) in places.items()
        if key not in NOT_WALKED and called(key, getattr(owner, name))
    }


def called(key, value):
    """Say whether users call it: functions and settings; no errors, no classes of results."""
    if not inspect.isclass(value):
        return callable(value)
    if issubclass(value, Exception) or getattr(value, "_is_protocol", False):
        return False
    return key in CALLS or ">>> " in (value.__doc__ or "") or not required(value)


def required(function):
    """Return the parameters that have no default."""
    return [
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.default is parameter.empty
        and name != "self"
        and not parameter.kind.name.startswith("VAR")
    ]


def listed(table, key):
    """Return the arguments that a table has for a name."""
    arguments = table.get(key, {})
    return arguments() if callable(arguments) else arguments


def good_call(key, owner, name, documented, folder, **instance):
    """Return the good call of a public name, or of a method; None where there is none."""
    function = getattr(owner, name)
    if key in CALLS:
        arguments = by_name(function, (), instance | listed(CALLS, key))
    else:
        arguments = recorded(owner, name, documented)
        if arguments is None and not required(function):
            arguments = by_name(function, (), instance)
    folder.keep()
    if arguments is None:
        return None
    return Call(key, function, arguments | listed(CHEAPER, key), folder)


def methods(call, documented, folder):
    """Yield the good calls of the public methods of an answer that take arguments."""
    answer, kind = call.made, type(call.made)
    for name in dir(kind):
        key, method = f"{kind.__name__}.{name}", getattr(kind, name)
        ours = (getattr(method, "__module__", "") or "").startswith("trustlab")
        if name.startswith("_") or not inspect.isroutine(method) or not ours or key in NOT_WALKED:
            continue
        parameters = set(inspect.signature(method).parameters)
        bound = "self" in parameters
        if parameters > {"self"} or (parameters and not bound):
            found = good_call(
                key, kind, name, documented, folder, **({"self": answer} if bound else {})
            )
            if found and bound and inspect.isclass(call.function):
                found.maker = call
            yield key, found


# Values to put in.

WORD = "misspelt"
ANYTHING = (None, WORD, object(), math.nan, -1, [], {}, np.array([1.0, math.nan]))
NUMBERS = (math.inf, -math.inf, 0, 0.5, 2, 3.7, 1e300, 10**400)
EXECUTION = ("n_jobs", "executor", "progress")
"""Arguments that change how an answer is computed, not the answer; they start no worker here."""


def values(call, argument):
    """Return what to put in: anything, then bad and other values like the good one."""
    good, kind = call.arguments[argument], call.annotation(argument)
    if argument in EXECUTION:
        return [WORD, object(), math.nan, {}]
    if isinstance(good, bool | np.bool_):
        return [*ANYTHING, not good, 1]
    tried = list(ANYTHING)
    if isinstance(good, int | float) or re.search(r"\b(float|int)\b", kind):
        tried += NUMBERS
    if isinstance(good, int | float) and math.isfinite(good):
        tried += [good + 1, 0.9 * good]
    elif isinstance(good, str):
        tried += ["", good[:-1]]
    elif isinstance(good, np.ndarray) and good.size:
        tried += [good[:-1], np.full(good.shape, math.nan), good[..., None], 0.9 * good]
    elif isinstance(good, list | tuple) and good:
        tried += [good[:-1], type(good)([None, *good[1:]]), [good], [WORD], [math.nan] * len(good)]
    elif isinstance(good, pd.DataFrame) and len(good):
        tried += [good.iloc[:0], good.iloc[:1], good.iloc[1:]]
        for name in good.columns:
            tried += [good.drop(columns=name), good.assign(**{str(name): math.nan})]
            tried += [good.assign(**{str(name): WORD})]
    elif isinstance(good, tl.Session):
        tried += [good.data, [good, good.between(0.0, 0.5 * good.duration)]]
        tried.append(good.between(0.0, 2.0 * good.sample_time))
        for name in good.columns[:-1]:
            tried.append(tl.Session(good.data.drop(columns=name), good.metadata))
    elif isinstance(good, Mapping) and good:
        tried += [dict(good) | {WORD: 1.0}, dict.fromkeys(good, math.nan)]
        tried += [{name: good[name] for name in good if name != left} for left in good]
    return tried


# What comes out.


def leaves(value, above=()):
    """Yield the plain values that an answer consists of."""
    if id(value) in above or len(above) > 12:
        return
    above = (*above, id(value))
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        yield value
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        yield from (value.shape, hash(value.tobytes()))
        yield math.nan if np.isnan(value).any() else 0.0
    elif isinstance(value, Path) and value.is_file():
        yield hash(value.read_bytes())
    elif isinstance(value, pd.Series | pd.Index):
        yield from leaves(value.to_numpy(), above)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        yield from leaves({name: value[name] for name in value.dtype.names}, above)
    elif isinstance(value, Mapping | pd.DataFrame):
        for name, item in value.items():
            yield str(name)
            yield from leaves(item, above)
    elif isinstance(value, list | tuple | np.ndarray):
        for item in value:
            yield from leaves(item, above)
    elif type(value).__module__.startswith("trustlab"):
        yield from leaves(getattr(value, "__dict__", None), above)
        for name in getattr(value, "__slots__", ()):
            yield from leaves(getattr(value, name, None), above)


PLAIN = ("builtins", "numpy", "pandas", "types")


def content(call, answer):
    """Return what can be compared of an answer, and whether NaN is in it."""
    if inspect.isclass(call.function):  # its arguments, not the memory that it has set aside
        stored = {name: getattr(answer, name, None) for name in call.arguments}
        answer = {name: x for name, x in stored.items() if type(x).__module__ in PLAIN}
    plain = list(leaves(answer))
    return repr(plain), any(isinstance(x, float | np.floating) and math.isnan(x) for x in plain)


def outcome(call, seconds=LIMIT, /, **changes):
    """Return (answer, None), or (None, error)."""

    def stop(*_):
        raise Hang(f"it takes more than {seconds:g} s")

    previous = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)  # again, if somebody catches it
    try:
        with warnings.catch_warnings(), redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            return call.answer(**changes), None
    except (Exception, Hang) as error:
        return None, error
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def fault_of_error(error, call):
    """Return what is wrong with an error, or None where the package itself says what to do."""
    *_, (frame, line) = traceback.walk_tb(error.__traceback__)
    file = frame.f_code.co_filename
    own = file.startswith(PACKAGE) and linecache.getline(file, line).lstrip().startswith("raise ")
    binding = isinstance(error, TypeError) and "keyword argument" in str(error)
    if not (own or binding) or not isinstance(error, ValueError | TypeError | OSError):
        return f"raises {type(error).__name__} ({error!s:.80}) at {Path(file).name}:{line}"
    tables = any(isinstance(x, pd.DataFrame | tl.Session | list) for x in call.arguments.values())
    words = [name.lower().rstrip("s").replace("_", "[_ ]") for name in [*call.arguments, WORD]]
    if not tables and not re.search("|".join(words), str(error).lower()):
        return f"is refused, and no argument is named: {error!s:.120}"
    return None


STATED = {
    r"\bin \(0, 1\)|strictly between 0 and 1": lambda x: 0.0 < x < 1.0,
    r"\bin \[0, 1\]|\bfrom 0 to 1\b": lambda x: 0.0 <= x <= 1.0,
    r"\bpositive\b|\babove 0\b": lambda x: x > 0.0,
    r"\b0 or more\b|\bnot negative\b": lambda x: x >= 0.0,
}
"""Words for a range in the description of an argument, and whether a number lies in it."""


def stated_out_of_range(call, argument, value):
    """Say whether a number lies outside of the range that the docstring gives an argument."""
    entry = rf"^(?:\w+, )*{argument}(?:, \w+)* : .*\n((?:    .*\n|\n)*)"
    found = re.search(entry, f"{inspect.getdoc(call.function)}\n", re.MULTILINE)
    if not found or not isinstance(value, int | float) or isinstance(value, bool):
        return False
    description = found[1].split(".\n")[0]
    ranges = [inside for words, inside in STATED.items() if re.search(words, description)]
    return bool(ranges) and not ranges[0](value)


def fault_of_answer(call, argument, value, new_nan):
    """Return what is wrong with an answer to a value, or None."""
    kind = call.annotation(argument)
    free = re.search(r"Any|Hashable|Mapping|object", kind)
    number = re.search(r"\b(float|int)\b", kind) and not re.search(r"Sequence|tuple|str", kind)
    never = (
        argument == WORD
        or (type(value) is object and not free and "Callable" not in kind)
        or (isinstance(value, float) and math.isnan(value) and number and not free)
        or (kind == "bool" and not isinstance(value, bool | np.bool_))
        or (kind.endswith("Callable") and not callable(value))
        or (argument == "seed" and value is None)  # other numbers at every call
        or stated_out_of_range(call, argument, value)
    )
    return "is taken" if never else "gives NaN" if new_nan else None


def same(value, good):
    try:
        return value is good or (type(value) is type(good) and bool(value == good))
    except (ValueError, TypeError):  # arrays and tables have no one truth
        return False


def alternative(value, good):
    """Say whether a value could make a difference; an empty one often means the default."""
    if value is None or (isinstance(value, str | list | dict) and not value):
        return False
    return not (np.isscalar(value) and np.isscalar(good) and value == good)


def faults(call):
    """Return what is wrong with a call, as lines of text."""
    call.made, error = outcome(call, COMPILED)
    if error:
        return [f"the good call raises {error!r}"]
    plain, has_nan = content(call, call.made)
    function = not inspect.isclass(call.function)
    repeats = not function or content(call, outcome(call)[0])[0] == plain
    judged = function and repeats and plain not in ("[]", "[None]")
    found = [] if repeats or call.name in ALLOWED else ["the same call gives another answer"]
    for argument in [*call.arguments, WORD]:
        if argument == "self":
            continue
        lines, effects = [], []
        good = call.arguments.get(argument, WORD)
        tried = [1.0] if good is WORD else values(call, argument)
        default = call.parameters[argument].default if argument in call.parameters else WORD
        for value in tried:
            if same(value, good) or same(value, default):
                continue
            answer, error = outcome(call, **{argument: value})
            if error is None:
                now, now_nan = content(call, answer)
                fault = fault_of_answer(call, argument, value, now_nan and not has_nan)
                effects += [now != plain] if alternative(value, good) else []
            else:
                fault = fault_of_error(error, call)
                if value is WORD:  # the error lists the options
                    options = re.findall(r"'(\w+)'", str(error).split(", got")[0])
                    tried += [option for option in options[:9] if option != WORD]
            if fault:
                lines.append(f"{argument} = {' '.join(repr(value).split()):.60} {fault}")
            plt.close("all")
        if judged and effects and not any(effects) and argument not in EXECUTION:
            lines.append(f"{argument} makes no difference")
        allowed = f"{call.name} {argument}" in ALLOWED
        found += [line for line in lines if not allowed or " raises " in line]
    return found
