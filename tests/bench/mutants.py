"""Small wrong changes of lib/light and lib/analysis, one at a time: do the tests that touch the line notice?

    $ pip install coverage && python -m tests.bench.mutants OUT [mutants] [seed] [seconds]

A seeded sample, stratified by module, of lines that some test runs in its own process (coverage says which): a
comparison, an operator, a number, a sign or a condition is changed in a copy of the tree, and the tests that touch the
line are run, the fastest first, until one fails. Compiled kernels (`*_kernels.py`) are left out: each would be
compiled anew. OUT/mutants.jsonl has a line for each, and is gone on with where it was left, so that it can be made in
pieces of some seconds; survivors are to be judged by a reader.
"""

import ast
import itertools
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path

import cv2  # noqa: F401  what tests import, once for all mutants
import numba  # noqa: F401
import pytest
import scipy.optimize  # noqa: F401
import scipy.sparse.csgraph  # noqa: F401
import scipy.spatial  # noqa: F401

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("lib/light", "lib/analysis")
MOST_TESTS, ENOUGH_S, MOST_S = 25, 4, 90  # of one mutant: tests, s that they take when all is well, CPU s
COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COMPARED |= {ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}
REVERSED = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE}
COUNTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
COUNTED |= {ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.FloorDiv: ast.Div, ast.MatMult: ast.Mult}


def mutations(tree):
    """[(line, what, change: node -> None, node)] of everything in a module that may be changed."""
    found = []
    for node in ast.walk(tree):
        line = getattr(node, "lineno", None)
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            for table in (COMPARED, REVERSED):
                if new := table.get(type(node.ops[0])):
                    what = f"{type(node.ops[0]).__name__} -> {new.__name__}"
                    found.append((line, what, node, lambda n, new=new: n.ops.__setitem__(0, new())))
        elif isinstance(node, ast.BinOp) and (new := COUNTED.get(type(node.op))):
            what = f"{type(node.op).__name__} -> {new.__name__}"
            found.append((line, what, node, lambda n, new=new: setattr(n, "op", new())))
        elif isinstance(node, ast.BoolOp):
            new = ast.Or if isinstance(node.op, ast.And) else ast.And
            found.append((line, f"-> {new.__name__}", node, lambda n, new=new: setattr(n, "op", new())))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            what = f"{type(node.op).__name__} dropped"
            found.append((line, what, node, lambda n: setattr(n, "op", ast.UAdd()) if _is_minus(n) else _drop(n)))
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            value = node.value + 1 if isinstance(node.value, int) else 1.5 * node.value + 1e-3
            what = f"{node.value} -> {value:g}"
            found.append((line, what, node, lambda n, value=value: setattr(n, "value", value)))
        elif isinstance(node, ast.Constant) and type(node.value) is bool:
            found.append((line, f"not {node.value}", node, lambda n: setattr(n, "value", not n.value)))
    return found


def _is_minus(node):
    return isinstance(node.op, ast.USub)


def _drop(node):
    node.operand = ast.UnaryOp(ast.Not(), node.operand)


def touched(out, tests):
    """{(file, line): [tests]}, and {test: s} of one run of them all under coverage."""
    data = out / "coverage"
    if not data.exists():
        settings = out / "coveragerc"
        source = ",".join(str(ROOT / p) for p in PACKAGES)
        settings.write_text(f"[run]\ndynamic_context = test_function\nsource = {source}\ndata_file = {data}\n")
        command = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", "-m", "pytest", "-q"]
        command += ["-m", "not scene and not slow and not outside", f"--junitxml={out / 'times.xml'}", *tests]
        subprocess.run(command, cwd=ROOT, check=False)
    from xml.etree import ElementTree

    import coverage

    seconds = defaultdict(float)
    for case in ElementTree.parse(out / "times.xml").iter("testcase"):
        name = case.get("classname") + "." + case.get("name").split("[")[0]
        seconds[name] += float(case.get("time"))
    lines = defaultdict(set)
    read = coverage.CoverageData(str(data))
    read.read()
    for path in read.measured_files():
        for line, contexts in read.contexts_by_lineno(path).items():
            lines[str(Path(path).relative_to(ROOT)), line] |= {c for c in contexts if c}
    return lines, seconds


def sample(lines, count, seed):
    """Mutants of touched lines: of each module as many as its share of lines, one of a line at most."""
    draw, drawn = random.Random(seed), []
    by_module = defaultdict(list)
    for path in sorted({path for path, _ in lines}):
        if path.endswith("_kernels.py"):
            continue
        tree = ast.parse((ROOT / path).read_text())
        inside = {
            n.lineno
            for f in ast.walk(tree)
            if isinstance(f, ast.FunctionDef)
            for n in ast.walk(f)
            if hasattr(n, "lineno")
        }
        for number, (line, what, *_) in enumerate(mutations(tree)):
            if line in inside and lines.get((path, line)):
                by_module[path].append((path, number, line, what))
    total = sum(map(len, by_module.values()))
    for mutants in by_module.values():
        draw.shuffle(mutants)
        seen, k = set(), max(round(count * len(mutants) / total), 1)
        one_of_a_line = [m for m in mutants if not (m[2] in seen or seen.add(m[2]))]
        drawn += one_of_a_line[:k]
    draw.shuffle(drawn)
    return drawn


def judged(copy, mutant, tests, seconds):
    """A row: whether a test noticed, and which tests were asked."""
    path, number, line, what = mutant
    tree = ast.parse((ROOT / path).read_text())
    _, _, node, change = mutations(tree)[number]
    change(node)
    (copy / path).write_text(ast.unparse(ast.fix_missing_locations(tree)))
    fastest = sorted(tests, key=lambda t: seconds.get(t, 1e9))
    spent = list(itertools.accumulate(seconds.get(t, 1e9) for t in fastest))
    asked = [t for k, t in enumerate(fastest) if k < 3 or (k < MOST_TESTS and spent[k] < ENOUGH_S)]
    names = [t.replace(".", "/", 1).replace(".", ".py::", 1) for t in asked]
    began = time.monotonic()
    try:
        caught = asked_of(copy, names)
    finally:  # also when interrupted: the next mutant stands alone
        shutil.copyfile(ROOT / path, copy / path)
    source = (ROOT / path).read_text().splitlines()[line - 1].strip()
    return {
        "path": path,
        "line": line,
        "what": what,
        "source": source,
        "verdict": caught,
        "tests": names[:3],
        "asked": len(names),
        "touching": len(tests),
        "s": round(time.monotonic() - began, 1),
    }


def asked_of(copy, names):
    """What pytest says of tests in the copy, in a fork of this process: the heavy packages are imported once."""
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status):
            hangs = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGALRM)
            return "caught (hangs)" if hangs else f"caught (-{os.WTERMSIG(status)})"
        code = os.WEXITSTATUS(status)
        return {0: "survived", 1: "caught"}.get(code, f"caught ({code})")
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_S, MOST_S + 5))
        signal.alarm(20 * MOST_S)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        os.chdir(copy)
        sys.path[:] = [str(copy)] + [p for p in sys.path if p not in ("", str(ROOT))]
        sys.dont_write_bytecode = True
        for name in [m for m in sys.modules if m.split(".")[0] in ("tests", "lib")]:
            del sys.modules[name]
        os._exit(int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *names])))
    finally:
        os._exit(99)


def main(out, count=200, seed=1, seconds=1e9):
    out, until = Path(out), time.monotonic() + float(seconds)
    out.mkdir(parents=True, exist_ok=True)
    words = [p.replace("/", ".") for p in PACKAGES]
    tests = [p for p in sorted((ROOT / "tests").glob("test_*.py")) if any(w in p.read_text() for w in words)]
    lines, took = touched(out, [str(t.relative_to(ROOT)) for t in tests])
    copy = out / "tree"
    if not copy.exists():
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv*", "build"), symlinks=True)
    path = out / "mutants.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {(r["path"], r["line"], r["what"]) for r in rows}
    for mutant in sample(lines, int(count), int(seed)):
        if (mutant[0], mutant[2], mutant[3]) in done:
            continue
        if time.monotonic() > until:
            print("to be gone on with")
            return
        rows.append(judged(copy, mutant, lines[mutant[0], mutant[2]], took))
        with open(path, "a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(rows[-1]["verdict"], *mutant, f"{rows[-1]['s']} s", flush=True)
    print(Counter(r["verdict"] for r in rows))


if __name__ == "__main__":
    main(*sys.argv[1:])
