"""Measures what the tests notice: changes one place of the source at a time, and counts the changes that fail a test.

``./dev mutate [MODULE...]`` runs the mutants of ``test/mutants/list.txt``, which was drawn by a fixed seed: all of a
module in WHOLE, a sample of the others. A mutant is known by its function, its source line without comments, its
change, and its number among equal ones in that function, and so survives edits elsewhere; one whose line was changed is
reported as gone. ``test/mutants/accepted.txt`` names survivors; a line below one says why it changes no behaviour. None
of these is run, since a survivor takes the longest; ``--record`` runs those without a reason. A run fails if another
mutant survives, or if one of a module in WHOLE has no reason.
"""
from __future__ import annotations

import argparse
import ast
import importlib
import io
import math
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
import tokenize
from bisect import bisect_right
from collections import Counter, defaultdict, deque
from datetime import date
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Iterable, Iterator, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
MUTANTS, PACKAGE = Path("test/mutants"), Path("src/car_interface")
SEED, MAX_PER_PART, MAX_PER_NODE = 20261125, 60, 15
# No mutant of these may survive: interlock, staleness, arbiters, ESC, channels, guard, gamepad and phone.
WHOLE = re.compile(r"interlock/|common/staleness|(steering|throttle)/arbiter|planner/source_arbiter|throttle/esc"
                   r"|pca9685/(channels|guard)|teleop/(gamepad|phone)")
# What decides. The Teensy's link and sensing belong to it: limits, obstacle stop and interlock go by their values.
PARTS = ("interlock", "steering", "throttle", "planner", "teleop", "pca9685", "teensy/link", "teensy/sensing", "nodes")
# A mutant is killed by tests that compute this many times as long as the clean run took, and so much more. What only
# takes long may be held up by other programs.
LIMIT_FACTOR, LIMIT_EXTRA_S = 3.0, 15.0
WAITING_FACTOR = 4.0  # a mutant that waits without end is killed after this many times as long
MAX_MEMORY = 8 * 2 ** 30  # bytes: for a mutant that appends without end

OPERATORS = {ast.Lt: "< <=", ast.LtE: "<= <", ast.Gt: "> >=", ast.GtE: ">= >", ast.Eq: "== !=", ast.NotEq: "!= ==",
             ast.Is: "is is_not", ast.IsNot: "is_not is", ast.In: "in not_in", ast.NotIn: "not_in in",
             ast.And: "and or", ast.Or: "or and", ast.Add: "+ -", ast.Sub: "- +", ast.Mult: "* /", ast.Div: "/ *",
             ast.FloorDiv: "// *", ast.Mod: "% *", ast.BitAnd: "& |", ast.BitOr: "| &", ast.BitXor: "^ |",
             ast.LShift: "<< >>", ast.RShift: ">> <<"}
TEXTS = (ast.JoinedStr, ast.Raise, ast.Assert)
LOG = re.compile(r"log(debug|info|warn|err|fatal)\w*|warn|print")


class Key(NamedTuple):
    """What identifies a mutant. The module is a path below src/car_interface."""

    module: str
    function: str
    line: str
    change: str
    number: int


class Place(NamedTuple):
    """The bytes from start to end become ``after``."""

    lineno: int
    start: int
    end: int
    after: bytes


class _Finder:
    """Finds the mutants of one module; ``found`` has them in the order of their places."""

    def __init__(self, module: str, source: bytes):
        self._source = source
        self._starts = [0, *accumulate(len(line) for line in source.splitlines(keepends=True))]
        lines, places, equal = source.decode().splitlines(), [], Counter()
        for token in tokenize.tokenize(io.BytesIO(source).readline):
            if token.type == tokenize.COMMENT:
                lines[token.start[0] - 1] = lines[token.start[0] - 1][:token.start[1]]
        self._walk(ast.parse(source), (), places)
        self.found: dict[Key, Place] = {}
        for place, function, change in sorted(places):
            code = lines[place.lineno - 1].strip()
            equal[function, code, change] += 1
            self.found[Key(module, function, code, change, equal[function, code, change])] = place

    def _walk(self, node, scope, places):
        """Collect the changes of a node and of all below it that is no text, annotation or decorator."""
        if isinstance(node, TEXTS) or self._is_silent(node):
            return
        below = ast.iter_child_nodes(node)
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            scope = (*scope, node.name)
            defaults = (*node.args.defaults, *node.args.kw_defaults) if isinstance(node, ast.FunctionDef) else ()
            below = (*filter(None, defaults), *node.body)
        elif isinstance(node, ast.AnnAssign):
            below = filter(None, (node.value,))
        elif isinstance(node, ast.Call) and LOG.fullmatch(getattr(node.func, "attr", getattr(node.func, "id", ""))):
            below = ()
        for change, start, end, after in self._changes(node, scope):
            place = Place(bisect_right(self._starts, start), start, end, after.encode())
            places.append((place, ".".join(scope) or "-", change))
        for each in below:
            self._walk(each, scope, places)

    def _is_silent(self, node):
        """Return whether it does nothing at run time, or only in a process of its own, or makes a text."""
        if isinstance(node, ast.If):
            return re.search("TYPE_CHECKING|__name__", self._text(node.test))
        return (isinstance(node, ast.FunctionDef) and node.name == "main") or (
            isinstance(node, (ast.Assign, ast.Expr)) and self._text(node).startswith(("__all__", "status.")))

    def _span(self, node):
        return (self._starts[node.lineno - 1] + node.col_offset,
                self._starts[node.end_lineno - 1] + node.end_col_offset)

    def _text(self, node):
        return self._source[slice(*self._span(node))].decode()

    def _changes(self, node, scope):
        """Yield the changes of one node: how they are called, from where to where, and what is there instead."""
        if isinstance(node, ast.Compare):
            for left, operator, right in zip([node.left, *node.comparators], node.ops, node.comparators):
                yield from self._operator("compare", left, operator, right)
        elif isinstance(node, ast.BoolOp):
            for left, right in zip(node.values, node.values[1:]):
                yield from self._operator("logic", left, node.op, right)
        elif isinstance(node, ast.BinOp) and not _is_text(node):
            yield from self._operator("arithmetic", node.left, node.op, node.right)
        elif isinstance(node, ast.AugAssign):
            yield from self._operator("arithmetic", node.target, node.op, node.value, "=")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            start, _ = self._span(node)
            yield "arithmetic - → +", start, start + 1, "+"
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield ("negate", *self._span(node), f"({self._text(node)[3:].strip()})")
        elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            value = node.value
            after = (not value if isinstance(value, bool) else 1.0 if value == 0.0 and isinstance(value, float) else
                     value + 1 if isinstance(value, int) and value < 1000 else value * 2)
            yield (f"constant {self._text(node)} → {after!r}", *self._span(node), repr(after))
        elif isinstance(node, ast.Return) and node.value is not None and (
                not isinstance(node.value, ast.Constant) or node.value.value):  # else as false as None is
            yield ("return None", *self._span(node), "return None")
        for test in (node.test,) if isinstance(node, (ast.If, ast.While, ast.IfExp)) else getattr(node, "ifs", ()):
            if not isinstance(test, (ast.UnaryOp, ast.Constant)) and not (  # else another mutant does the same
                    isinstance(test, ast.Compare) and not isinstance(test.ops[0], (ast.Lt, ast.LtE, ast.Gt, ast.GtE))):
                yield ("negate", *self._span(test), f"not ({self._text(test)})")
        targets = [each for target in getattr(node, "targets", [getattr(node, "target", None)])
                   for each in getattr(target, "elts", [target])]
        is_assignment = isinstance(node, (ast.Assign, ast.AugAssign)) or (
            isinstance(node, ast.AnnAssign) and node.value is not None)
        if (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)) or (
                is_assignment and scope[-1:] != ("__init__",)  # without one of these everything fails
                and any(isinstance(each, (ast.Attribute, ast.Subscript)) for each in targets)):
            yield ("drop", *self._span(node), "pass")

    def _operator(self, kind, left, operator, right, suffix=""):
        before, after = (text.replace("_", " ") + suffix for text in OPERATORS.get(type(operator), "? ?").split())
        start, end = self._span(left)[1], self._span(right)[0]
        match = re.search(re.escape(before), self._source[start:end].decode())
        if match and b"#" not in self._source[start:end]:
            yield f"{kind} {before} → {after}", start + match.start(), start + match.end(), after


def _is_text(node):
    """Return whether a sum is one of texts or lists, which have no other arithmetic."""
    if isinstance(node, ast.BinOp):
        return _is_text(node.left) or _is_text(node.right)
    return isinstance(node, (ast.JoinedStr, ast.List, ast.ListComp, ast.Tuple)) or (
        isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes)))


def find(module: str, source: bytes) -> dict[Key, Place]:
    """Return all mutants of a module, in the order of their places."""
    return _Finder(module, source).found


def draw(module: str, found: Iterable[Key], limit: int) -> list[Key]:
    """Return at most ``limit`` of a module's mutants, in turn one of each kind of change, by the fixed seed."""
    keys, kinds, drawn = list(found), defaultdict(list), []
    for key in keys:
        kinds[key.change.split()[0]].append(key)
    order = random.Random(f"{SEED} {module}")
    for each in kinds.values():
        order.shuffle(each)
    while len(drawn) < limit and any(kinds.values()):
        drawn += [each.pop() for _, each in sorted(kinds.items()) if each][:limit - len(drawn)]
    return sorted(drawn, key=keys.index)


def draw_list(root: Path, before: dict[str, list[Key]], names: list[str]) -> dict[str, list[Key]]:
    """Return the list of mutants with those of the named modules drawn anew."""
    drawn = dict(before)
    for path in sorted((root / PACKAGE).rglob("*.py")):
        module = path.relative_to(root / PACKAGE).as_posix()
        if is_named(module, names):
            found = find(module, path.read_bytes())
            drawn[module] = list(found) if WHOLE.match(module) else draw(
                module, found, MAX_PER_NODE if module.startswith("nodes/") else MAX_PER_PART)
    return {module: keys for module, keys in drawn.items() if keys}


def is_named(module: str, names: list[str]) -> bool:
    """Return whether a module, or a folder that it is in, is among the names; without names all are."""
    return not names or any(f"{module[:-3]}/".startswith(f"{name.replace('.py', '').strip('/')}/") for name in names)


def to_text(lists: dict[str, list[Key]], titles: dict[str, str], reasons: dict[Key, str]) -> str:
    """Return the text of mutants: a line for each module (its title), function, mutant, and reason to accept it."""
    lines = []
    for module, keys in lists.items():
        lines.append(titles.get(module, module))
        for before, key in zip([None, *keys], keys):
            if before is None or before.function != key.function:
                lines.append(f"  {key.function}")
            lines.append(f"    {key.change}\t{key.line}" + (f"\t{key.number}" if key.number > 1 else ""))
            lines += [f"      {reasons[key]}"] if key in reasons else []
    return "".join(line + "\n" for line in lines)


def from_text(text: str) -> tuple[dict[str, list[Key]], dict[str, str], dict[Key, str]]:
    """Return the mutants and the title of each module, and the reasons to accept a mutant."""
    lists, titles, reasons, module, function = {}, {}, {}, "", ""
    for line in text.splitlines():
        if line.startswith("      "):
            reasons[lists[module][-1]] = line.strip()
        elif line.startswith("    "):
            change, code, number = (*line[4:].split("\t"), "1")[:3]
            lists[module].append(Key(module, function, code, change, int(number)))
        elif line.startswith("  "):
            function = line[2:]
        else:
            module = line.split()[0]
            lists[module], titles[module] = [], line
    return lists, titles, reasons


@lru_cache(maxsize=None)
def imports(path: Path) -> set[str]:
    """Return the full names that a file imports, anywhere in it; relative ones begin with a dot."""
    names = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{'.' * node.level}{node.module or ''}.{each.name}" for each in node.names}
    return names


def imported(path: Path, root: Path) -> set[str]:
    """Return the modules of the package that a file imports."""
    names = {each for name in imports(path) for each in (name, name.rpartition(".")[0])}
    paths = (name[len("car_interface."):].replace(".", "/") + ".py" for name in names
             if name.startswith("car_interface."))
    return {module for module in paths if (root / PACKAGE / module).exists()}


def tests_of(root: Path, modules: Iterable[str]) -> dict[str, list[str]]:
    """Return the test files of each module, its own first: those of its folder, and those of others that import it.

    Tests of the tools (calibration, report and so on) are left out: they take long, and notice by accident. For a node
    also test/graph; for declared parameters also the test of their tables in the documentation.
    """
    files = {path.relative_to(root).as_posix(): imported(path, root) for part in (*PARTS, "common", "ros")
             for path in sorted((root / "test/unit" / part).rglob("test_*.py"))}
    graph = [path.relative_to(root).as_posix() for path in sorted((root / "test/graph").rglob("test_*.py"))]
    tests = {}
    for module in modules:
        folder, stem = f"test/unit/{Path(module).parent.as_posix()}", Path(module).stem
        own = [name for name in files if re.fullmatch(rf"{folder}/test_{stem}(_\w+)?\.py", name)]
        near = [name for name in files if Path(name).parent.as_posix() == folder]
        others = [name for name in files if module in files[name]]
        is_declared = any("common.declared" in name for name in imports(root / PACKAGE / module))
        tables = ["test/unit/test_documentation.py"] if is_declared else []
        tests[module] = list(dict.fromkeys([
            *own, *near, *others, *tables, *(graph if module.startswith("nodes/") else ())]))
    return tests


class Job(NamedTuple):
    """A run of test files, with a mutant or, for the clean run, without."""

    key: Key | None
    place: Place | None
    tests: list[str]
    limit_s: float


class Result(NamedTuple):
    """How a job ended; ``called``: each module and name of a function that the clean run called."""

    job: Job
    passed: bool
    took_s: float
    log: str
    called: set[str]


class Slot:
    """A copy of the checkout, in which one job runs at a time.

    Its ``path`` makes car_interface of the copy's modules and of the messages that the workspace has generated.
    """

    def __init__(self, root: Path, folder: Path):
        self.job = None
        self._root, self._folder, self._copy = root, folder, folder / "copy"
        shutil.copytree(root, self._copy, symlinks=True, ignore=shutil.ignore_patterns(".git", "__pycache__"))
        built = [f"{each}/car_interface" for each in os.environ.get("PYTHONPATH", "").split(":")
                 if os.path.isdir(f"{each}/car_interface/msg")]
        for name in ("path/car_interface", "tmp"):
            (folder / name).mkdir(parents=True)
        init = f"__path__ = {[str(self._copy / PACKAGE), *built]}\n"
        (folder / "path/car_interface/__init__.py").write_text(init, encoding="utf-8")
        (folder / "called").touch()

    def begin(self, job: Job) -> None:
        """Fork a process for a job, which has what this one has imported."""
        self.job, self._begun_s = job, time.monotonic()
        if job.key:
            path = self._copy / PACKAGE / job.key.module
            source = path.read_bytes()
            path.write_bytes(source[:job.place.start] + job.place.after + source[job.place.end:])
            os.utime(str(path), (1, 1))  # older than any byte code
        self._pid = os.fork()
        if not self._pid:
            try:
                code = self._run(job)
            except BaseException:
                code = 3
            os._exit(code)

    def _run(self, job):
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(job.limit_s),) * 2)
        log = os.open(str(self._folder / "log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for number, file in enumerate((os.open(os.devnull, os.O_RDONLY), log, log)):
            os.dup2(file, number)
        os.chdir(str(self._copy))
        path, tmp = (str(self._folder / name) for name in ("path", "tmp"))
        os.environ.update(TMPDIR=tmp, PYTHONPATH=os.pathsep.join([path, os.environ.get("PYTHONPATH", "")]))
        tempfile.tempdir = tmp
        sys.path.insert(0, path)
        if job.key:
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
            sys.dont_write_bytecode = True
        called: dict = {}  # by id, since code objects are slow to compare

        def note(frame, *_):
            called.setdefault(id(frame.f_code), frame.f_code)
        if not job.key:
            threading.settrace(note)
            sys.settrace(note)
        code = self._pytest(job.tests) if job.tests else 0
        sys.settrace(None)
        package = f"{self._copy / PACKAGE}/"
        (self._folder / "called").write_text("\n".join(
            f"{each.co_filename.replace(package, '')} {each.co_name}" for each in called.values()), encoding="utf-8")
        return int(code)

    def _pytest(self, tests):
        code = importlib.import_module("pytest").main(
            ["-q", "-x", "--tb=short", "-p", "no:cacheprovider", "-p", "no:randomly", "-p", "no:xdist",
             "-m", "not browser", f"--basetemp={self._folder}/tmp/pytest", *tests])
        return 0 if code == 5 else code  # none of its tests does without a browser

    def poll(self) -> Result | None:
        """Return how the job ended, or None while it runs."""
        pid, status = os.waitpid(self._pid, os.WNOHANG)
        took_s = time.monotonic() - self._begun_s
        if not pid and took_s < WAITING_FACTOR * self.job.limit_s:
            return None
        self.end()
        if not pid:
            os.waitpid(self._pid, 0)
        job, self.job = self.job, None
        log, called = ((self._folder / name).read_text("utf-8", "replace") for name in ("log", "called"))
        if job.key:
            shutil.copy2(str(self._root / PACKAGE / job.key.module), str(self._copy / PACKAGE / job.key.module))
        return Result(job, bool(pid) and not status, took_s, log, set(called.splitlines()))

    def end(self) -> None:
        """End the job, or what it has left behind."""
        try:
            os.killpg(self._pid, signal.SIGKILL)
        except OSError:
            pass  # there is nothing left


def run(slots: list[Slot], jobs: Iterable[Job]) -> Iterator[Result]:
    """Run jobs, one in each slot at a time; yield those that ended."""
    waiting = deque(jobs)
    try:
        while waiting or any(slot.job for slot in slots):
            for slot in slots:
                if not slot.job and waiting:
                    slot.begin(waiting.popleft())
                result = slot.poll() if slot.job else None
                if result:
                    yield result
            time.sleep(0.005)
    finally:
        for slot in slots:
            if slot.job:
                slot.end()


def run_clean(slots: list[Slot], files: Iterable[str]) -> dict[str, Result]:
    """Run test files without a mutant; exit if one of them fails."""
    clean = {}
    for result in run(slots, [Job(None, None, [name], 900.0) for name in files]):
        (name,) = result.job.tests
        if not result.passed:
            sys.exit(f"{name} fails without any mutant:\n{result.log[-3000:]}")
        clean[name] = result
    return clean


def job_of(key: Key, place: Place, files: list[str], clean: dict[str, Result]) -> Job:
    """Return a mutant's job: the module's own tests, then the fastest, without those that don't call its function."""
    name = key.function.rpartition(".")[2].replace("-", "<module>")
    tests = [each for each in files if f"{key.module} {name}" in clean[each].called]
    tests.sort(key=lambda each: (each != files[0], clean[each].took_s))
    return Job(key, place, tests, LIMIT_EXTRA_S + LIMIT_FACTOR * sum(clean[each].took_s for each in tests))


def run_mutants(root: Path, slots: list[Slot], lists: dict[str, list[Key]]) -> Iterator[tuple[str, list[Key], dict]]:
    """Run the mutants; yield each module that is done with its survivors and the places of all that are not gone."""
    files, places, left, survivors = tests_of(root, lists), {}, Counter(), defaultdict(list)
    clean = run_clean(slots, dict.fromkeys(name for names in files.values() for name in names))
    print(f"The tests pass without a mutant, in {sum(each.took_s for each in clean.values()):.0f} s", flush=True)
    jobs = []
    for module, keys in lists.items():
        path = root / PACKAGE / module
        found = find(module, path.read_bytes()) if path.exists() else {}
        places[module] = {key: found[key] for key in keys if key in found}
        jobs += [job_of(key, place, files[module], clean) for key, place in places[module].items()]
        left[module] = len(places[module])
        if not left[module]:
            yield module, [], {}
    for result in run(slots, jobs):
        module = result.job.key.module
        survivors[module] += [result.job.key] if result.passed else []
        left[module] -= 1
        if not left[module]:
            yield module, sorted(survivors[module], key=lists[module].index), places[module]


def main() -> int:
    parser = argparse.ArgumentParser(prog="./dev mutate", description="Change one place of the source at a time, and "
                                     "count the changes that fail a test.")
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="throttle/control, or a folder such as throttle")
    parser.add_argument("--draw", action="store_true", help="draw the mutants of these modules anew, and run nothing")
    parser.add_argument("--record", action="store_true", help="accept the results of this run")
    parser.add_argument("--sample", type=int, metavar="N", help="run only N of the mutants, drawn by the day")
    parser.add_argument("--mechanisms", action="store_true", help="switch off the mechanisms of the safety case "
                        "instead, one at a time: each test that is named for one must fail")
    options = parser.parse_args()
    files = [ROOT / MUTANTS / name for name in ("list.txt", "accepted.txt")]
    (everything, *_), (accepted, titles, reasons) = (
        from_text(path.read_text(encoding="utf-8") if path.exists() else "") for path in files)
    if options.draw:
        if not options.modules:
            parser.error("--draw needs a MODULE")
        files[0].write_text(to_text(draw_list(ROOT, everything, options.modules), {}, {}), encoding="utf-8")
        return 0
    known = {module: [key for key in accepted.get(module, ()) if key in keys and key not in reasons]
             for module, keys in everything.items() if not options.record}
    lists = {module: [key for key in keys if key not in reasons and key not in known.get(module, ())]
             for module, keys in everything.items() if is_named(module, options.modules)}
    if options.sample:
        everyone = [key for keys in lists.values() for key in keys]
        drawn = set(random.Random(date.today().isoformat()).sample(everyone, min(options.sample, len(everyone))))
        lists = {module: [key for key in keys if key in drawn] for module, keys in lists.items()}
        lists = {module: keys for module, keys in lists.items() if keys}
    if not lists and not options.mechanisms:
        parser.error(f"{MUTANTS}/list.txt has no module named {' or '.join(options.modules)}")
    for name in ("pytest", "hypothesis", "numpy", "yaml", "serial"):  # once, for all mutants
        importlib.import_module(name)
    os.environ.pop("PYTHONPYCACHEPREFIX", None)
    sys.pycache_prefix = None  # byte code goes into the copies
    sums, worse, new = Counter(), [], {}
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        os.chmod(folder, 0o755)  # some tests do things as another user
        kind = importlib.import_module("mechanisms").ProcessSlot if options.mechanisms else Slot
        slots = [kind(ROOT, Path(folder, str(index))) for index in range(len(os.sched_getaffinity(0)))]
        if options.mechanisms:
            return importlib.import_module("mechanisms").report(ROOT, slots, options.modules)
        for module, fresh, places in run_mutants(ROOT, slots, lists):
            survivors = fresh if options.sample else [*known.get(module, ()), *fresh]
            killed, total = len(places) - len(fresh), len(places) + len(survivors) - len(fresh)
            title = f"{module} {killed}/{total}"
            print(title, *(f"  {PACKAGE / module}:{places[key].lineno} {key.change} | {key.line}"
                           + (f" ({key.number})" if key.number > 1 else "") for key in fresh),
                  *(f"  gone: {key.function}: {key.change} | {key.line}" for key in lists[module] if key not in places),
                  sep="\n", flush=True)
            bad = survivors if WHOLE.match(module) else fresh
            if bad:
                worse.append(f"{module}: " + "; ".join(f"{key.function}: {key.change} | {key.line}" for key in bad))
            kind = "nodes and ros" if module.startswith(("nodes/", "ros/")) else "core"
            sums[kind, "killed"] += killed
            sums[kind, "all"] += total
            equivalent = [key for key in accepted.get(module, ()) if key in reasons and key in everything[module]]
            new[module], titles[module] = sorted([*survivors, *equivalent], key=everything[module].index), title
    for kind in sorted({kind for kind, _ in sums}):
        killed, total = sums[kind, "killed"], sums[kind, "all"]
        print(f"{kind}: {killed} of {total} mutants killed, {100 * killed / max(1, total):.1f} %")
    if options.record:
        merged = {**accepted, **new}
        files[1].write_text(to_text({module: merged[module] for module in everything if module in merged}, titles,
                                    reasons), encoding="utf-8")
        return 0
    print(*(f"Survives, and isn't accepted: {each}" for each in worse), sep="\n", end="\n" if worse else "")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
