"""
`python -m trustlab.live.build`: numba's LLVM IR of a tick of the ground robot, and of a period of a
flight and of a team, compiled to WebAssembly for browsers.

The bits are the same because both come from one IR whose arithmetic IEEE 754 fixes: no library
functions, no contraction to fused multiply-adds, no vectors. Needs llvmlite (numba's own
dependency) and the linker `wasm-ld` of LLVM (Debian: package lld), or the package `ziglang`, which
has one. The file is committed with a digest of its sources; `sources_digest()` of a checkout tells
whether they have parted.
"""

import inspect
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tokenize
from pathlib import Path
from typing import Any

from trustlab.models.digest import digest

STATIC = Path(__file__).parent / "static"
WASM, STAMP = STATIC / "kernel.wasm", STATIC / "kernel.json"

# What numba reads when it is imported: IR for no processor in particular.
GENERIC = {
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    "NUMBA_DISABLE_INTEL_SVML": "1",
    "NUMBA_LOOP_VECTORIZE": "0",
    "NUMBA_SLP_VECTORIZE": "0",
}


def sources(function: Any, texts: dict[str, str]) -> None:
    """
    Add the text of a compiled function, of those that it calls, and of the constants that they
    read, by name.
    """
    plain = getattr(function, "py_func", function)
    name = f"{plain.__module__}.{plain.__qualname__}"
    if name in texts:
        return
    tokens = tokenize.generate_tokens(io.StringIO(inspect.getsource(plain)).readline)
    idle = {
        tokenize.COMMENT,
        tokenize.STRING,
        tokenize.NL,
    }  # kernels hold no texts but their docstrings
    texts[name] = " ".join(token.string for token in tokens if token.type not in idle)
    words = set(plain.__code__.co_names)
    values = {word: plain.__globals__[word] for word in words & set(plain.__globals__)}
    for module in list(values.values()):
        if inspect.ismodule(module) and module.__name__.startswith("trustlab"):
            values |= {word: getattr(module, word) for word in words & set(vars(module))}
    for word, value in sorted(values.items()):
        if hasattr(value, "py_func"):
            sources(value, texts)
        elif hasattr(value, "_fields"):
            texts[f"{name}.{word}"] = repr(value._fields)
        elif isinstance(value, int | float | tuple):
            texts[f"{name}.{word}"] = repr(value)


def sources_digest() -> str:
    """
    Return a digest of all that the WebAssembly file is made of: functions, constants, records and
    signatures.
    """
    from trustlab.live import noise, tick
    from trustlab.live.tasks import flown, led
    from trustlab.teleoperation.team import kernel

    texts: dict[str, str] = {}
    for function, _ in (tick.ENTRIES | flown.ENTRIES | led.ENTRIES).values():
        sources(function, texts)
    for function in (
        noise.uniform,
        noise.normal,
    ):  # methods of a record there, so that no name leads to them
        sources(function, texts)
    kinds = [tick.TASK, tick.ROBOT, tick.FORCING, tick.STATE, tick.LOG, noise.HASHED]
    kinds += [flown.ADDRESSES, flown.HAND, flown.NUMBERS, flown.STATE, flown.INPUT, flown.SAMPLE]
    kinds += [led.ADDRESSES, led.LEAD, led.FOLLOWER, led.ROW, led.ACCOUNT]
    kinds += [kernel.NUMBERS, kernel.ROBOT, kernel.INPUT, kernel.SAMPLE, kernel.STATE]
    records = [repr(kind) for kind in kinds]
    return digest(*records, *(f"{name} {text}" for name, text in sorted(texts.items())))


# A power of 2 in two halves, either of which is a normal number: exact where the result is one.
LDEXP = """
define internal double @numba_ldexp(double %x, i32 %n) {
  %half = sdiv i32 %n, 2
  %rest = sub i32 %n, %half
  %a = add i32 %half, 1023
  %b = add i32 %rest, 1023
  %c = zext i32 %a to i64
  %d = zext i32 %b to i64
  %e = shl i64 %c, 52
  %f = shl i64 %d, 52
  %g = bitcast i64 %e to double
  %h = bitcast i64 %f to double
  %i = fmul double %x, %g
  %j = fmul double %i, %h
  ret double %j
}
"""


def llvm_ir(name: str, function: Any, signature: Any) -> str:
    """Return numba's IR of a function, fit for WebAssembly, where it has this name."""
    import numba

    made = numba.njit(
        signature, no_cpython_wrapper=True, no_cfunc_wrapper=True, error_model="numpy"
    )(function)
    full = made.overloads[made.signatures[0]].fndesc.mangled_name
    ir = made.inspect_llvm(made.signatures[0])
    ir = re.sub(r'target triple = ".*"', 'target triple = "wasm32-unknown-unknown"', ir)
    ir = re.sub(r'target datalayout = ".*"\n', "", ir)
    ir = re.sub(r'"target-cpu"="[^"]*"|"target-features"="[^"]*"', "", ir)
    # Arrays made of pointers own nothing: there is nothing to count.
    ir = re.sub(r"define [^\n]*@NRT_\w+\(.*?\n}\n", "", ir, flags=re.S)
    ir = re.sub(r"declare [^\n]*@NRT_\w+\(.*\n", "", ir)
    ir += "".join(
        f"define internal void @{name}(ptr %x) {{ ret void }}\n"
        for name in ("NRT_incref", "NRT_decref")
    )
    ir, powers = re.subn(r"declare [^\n]*@numba_ldexp\(.*\n", "", ir)
    ir += LDEXP if powers else ""
    # WebAssembly has no common symbols.
    ir = re.sub(
        r" = common local_unnamed_addr global (\S+) null", r" = internal global \1 null", ir
    )
    return ir.replace(f'@"{full}"(', f"@{name}(").replace(f"@{full}(", f"@{name}(")


def linker() -> list[str]:
    """Return the command of a linker of WebAssembly."""
    from importlib.util import find_spec

    if path := shutil.which("wasm-ld"):
        return [path]
    if find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "wasm-ld"]
    raise SystemExit(
        "no linker: install LLVM's wasm-ld (Debian: apt install lld) or the Python package ziglang"
    )


def build() -> None:
    """Write the WebAssembly file and the digest of its sources."""
    import llvmlite.binding as llvm

    from trustlab.live import tick
    from trustlab.live.tasks import flown, led

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple("wasm32-unknown-unknown")
    entries = tick.ENTRIES | flown.ENTRIES | led.ENTRIES
    texts = {name: llvm_ir(name, *entry) for name, entry in entries.items()}
    with tempfile.TemporaryDirectory() as folder:
        objects = []
        for name, ir in texts.items():
            module = llvm.parse_assembly(ir)
            module.verify()
            path = Path(folder) / f"{name}.o"
            path.write_bytes(
                target.create_target_machine(opt=2, reloc="static").emit_object(module)
            )
            objects.append(str(path))
        exports = [f"--export={name}" for name in texts]
        options = [
            "--no-entry",
            "--export=__heap_base",
            "--gc-sections",
            "--strip-all",
            "-z",
            "stack-size=65536",
        ]
        subprocess.run([*linker(), *options, *exports, *objects, "-o", str(WASM)], check=True)
    stamp = {"sources": sources_digest(), "file": digest(WASM.read_bytes())}
    STAMP.write_text(json.dumps(stamp, indent=1) + "\n")
    print(f"{WASM.name}: {WASM.stat().st_size} bytes")


if __name__ == "__main__":
    os.environ.update(GENERIC)
    build()
