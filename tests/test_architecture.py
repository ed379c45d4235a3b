"""Who may import whom, and what `import jaxscan` may load: the rules of the house, by `ast`."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

from tests.every_file import for_every, tree_of


ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "jaxscan"
FILES = sorted(PACKAGE.rglob("*.py"))
RIG = ROOT / "hardware" / "scanrig"
RIG_FILES = sorted(RIG.rglob("*.py"))
BENCH = ROOT / "hardware" / "bench"
BENCH_FILES = sorted(BENCH.rglob("*.py"))

CORE = {
    "geometry",
    "leastsq",
    "stripes",
    "reconstruction",
    "observation",
    "calibration",
    "measurement",
    "recalibration",
    "photographs",
    "surface",
    "drawing",
    "design",
}
ANY = CORE | {"simulation", "vision", "files", "report", "cli", "data", "api", "web", "viewer", "project"}
MAY_IMPORT = {
    "geometry": set(),
    "stripes": {"geometry"},
    "reconstruction": {"geometry", "stripes"},
    "observation": {"geometry", "stripes"},
    "leastsq": {"geometry"},
    "calibration": {"geometry", "observation", "leastsq"},
    "measurement": {"geometry"},
    "drawing": {"geometry", "measurement"},
    "design": {"geometry", "reconstruction"},
    "recalibration": {"geometry", "leastsq", "stripes", "reconstruction", "observation", "calibration", "measurement"},
    "photographs": {"geometry", "stripes", "reconstruction"},
    "surface": {"geometry", "reconstruction"},
    "simulation": {"geometry", "vision"},
    "vision": CORE,
    "files": CORE | {"vision", "simulation"},
    "report": CORE | {"vision"},
    "web": set(),
    "project": CORE | {"files", "api"},
    "viewer": {"geometry", "measurement", "reconstruction", "surface", "web"},
    "api": ANY - {"api", "cli", "web", "viewer", "project"},
    "cli": ANY,
    "__init__": ANY,
    "errors": set(),
    "compiling": set(),
    "memory": set(),
    "__main__": {"cli"},
    "printable": set(),
    "facades": set(),
    "data": set(),
}
"""Folders of the package that a folder may import, beside itself and what all may import."""

FOR_ALL = {"compiling", "errors", "facades", "memory", "printable"}
"""Files of the package that import nothing, and that all may import."""

HOME_OF = {
    "cv2": {"vision"},
    "embreex": {"simulation/scene/meshes.py"},
    "open3d": {"surface/poisson.py"},
    "libusb_package": {"surface/poisson.py"},
    "fast_simplification": {"surface/poisson.py"},
    "pye57": {"files"},
    "ezdxf": {"files/drawings.py"},
    "ifcopenshell": {"files/ifc.py"},
    "laspy": {"files"},
    "pyproj": {"files"},
    "yaml": {"files/calibration/cameras.py"},
    "serial": set(),
    "aiohttp": {"web", "viewer", "cli/console"},
    "yarl": {"web"},
    "numba": set(),
    "isal": {"vision"},
    "simplejpeg": {"vision"},
    "scipy": {
        "drawing/contours.py",
        "measurement",
        "recalibration",
        "report/clouds/facts.py",
        "simulation/boards.py",
        "surface/atlas.py",
        "leastsq/robust.py",
        "geometry/rigid.py",
        "stripes/predict.py",
    },
    "optimistix": {"leastsq/solver.py"},
    "lineax": {"leastsq/solver.py"},
    "matplotlib": {"report"},
    "rich": {"cli"},
    "pydantic": {"files", "simulation", "project/config.py"},
}
"""Third-party libraries that belong to one place."""

RIG_MAY_IMPORT = {"files", "geometry", "stripes"} | FOR_ALL
"""Folders of the package that the acquisition layer may import."""

BENCH_MAY_IMPORT = {"files", "simulation", "vision"} | FOR_ALL
"""Folders of the package that the simulated rig may import: what renders, nothing that estimates."""

RIG_HOME_OF = {"cv2": ("cameras/",), "serial": ("wire.py",), "ctypes": ("cameras/aravis",)}
"""Libraries that belong to one place of the acquisition layer."""


def folder_of(path):
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


@functools.cache
def imports(path):
    """(module, line) of every import in a file, also those inside functions."""
    return tuple(_imports(path))


def _imports(path):
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            if node.module == "jaxscan":
                yield from ((f"jaxscan.{alias.name}", node.lineno) for alias in node.names)
            else:
                yield node.module, node.lineno


@for_every(FILES)
def test_import_direction(path):
    here = folder_of(path)
    for module, line in imports(path):
        parts = module.split(".")
        if parts[0] != "jaxscan" or len(parts) == 1:
            continue
        there = parts[1]
        assert there in MAY_IMPORT[here] | FOR_ALL | {here}, f"line {line}: {here} must not import {there}"


OUTSIDE_OF_FILES = [path for path in (*FILES, *RIG_FILES, *BENCH_FILES) if PACKAGE / "files" not in path.parents]


@for_every(OUTSIDE_OF_FILES, lambda path: str(path.relative_to(ROOT)))
def test_files_are_reached_through_the_facades_of_their_rooms(path):
    for module, line in imports(path):
        inside = module.split(".")[:2] == ["jaxscan", "files"]
        assert not inside or len(module.split(".")) <= 3, f"line {line}: {module}"


@for_every([path for path in FILES if folder_of(path) == "files"])
def test_a_room_of_files_reaches_others_through_their_facades(path):
    for module, line in imports(path):
        parts = module.split(".")
        room = path.relative_to(PACKAGE / "files").parts[0]
        if parts[:2] == ["jaxscan", "files"] and path.name != "__init__.py" and parts[2] != room:
            assert len(parts) == 3, f"line {line}: {module}"


@for_every([*FILES, *RIG_FILES, *BENCH_FILES])
def test_stripes_are_reached_through_their_facade(path):
    if path.is_relative_to(PACKAGE / "stripes"):
        return
    for module, line in imports(path):
        assert not module.startswith("jaxscan.stripes."), f"line {line}: {module}, expected jaxscan.stripes"


@for_every(FILES)
def test_libraries_stay_in_their_place(path):
    where = str(path.relative_to(PACKAGE))
    for module, line in imports(path):
        homes = HOME_OF.get(module.split(".")[0])
        if homes is not None:
            assert any(where == home or where.startswith(home + "/") for home in homes), f"line {line}: {module}"


@for_every(RIG_FILES)
def test_the_acquisition_layer_imports_what_writes_captures(path):
    where = str(path.relative_to(RIG))
    for module, line in imports(path):
        first, *rest = module.split(".")
        assert first not in {"bench", "open3d", "jax", "rich"}, f"line {line}: {module}"
        if first == "jaxscan":
            assert rest and rest[0] in RIG_MAY_IMPORT, f"line {line}: {module}"
        homes = RIG_HOME_OF.get(first)
        if homes is not None:
            assert where.startswith(homes), f"line {line}: {module}"


def _modules():
    """Every module of the three packages, by its name."""
    found = {}
    for package in (PACKAGE, RIG, BENCH):
        for path in package.rglob("*.py"):
            parts = [package.name, *path.relative_to(package).with_suffix("").parts]
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def _imported_modules(path, known):
    """The modules among `known` that a file imports, also where only a type checker or a function does."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


def _circle(graph):
    """A circle of a graph as the names along it; None where there is none."""
    done = set()

    def walk(name, way):
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return None
        for other in sorted(graph.get(name, ())):
            if found := walk(other, [*way, name]):
                return found
        done.add(name)
        return None

    return next((found for name in sorted(graph) if (found := walk(name, []))), None)


def test_a_circle_is_found():
    assert _circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert _circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) is None


def test_no_module_imports_itself_by_way_of_others():
    known = _modules()
    graph = {name: set(_imported_modules(path, known)) - {name} for name, path in known.items()}
    circle = _circle(graph)
    assert circle is None, " imports ".join(circle)


def test_no_room_of_the_acquisition_layer_imports_itself_by_way_of_others():
    """Rooms are its folders; a file beside them is one of its own."""
    known = _modules()
    graph = {}
    for name, path in known.items():
        here = ".".join(name.split(".")[:2])
        there = {".".join(other.split(".")[:2]) for other in _imported_modules(path, known)}
        if name.startswith("scanrig."):
            graph.setdefault(here, set()).update(room for room in there if room.startswith("scanrig.") and room != here)
    circle = _circle(graph)
    assert circle is None, " imports ".join(circle)


@for_every(BENCH_FILES)
def test_the_bench_knows_no_estimator(path):
    for module, line in imports(path):
        first, *rest = module.split(".")
        assert first != "scanrig", f"line {line}: {module}"
        if first == "jaxscan":
            assert rest and rest[0] in BENCH_MAY_IMPORT, f"line {line}: {module}"


@for_every(FILES)
def test_only_the_command_line_knows_the_acquisition_layer(path):
    found = [line for module, line in imports(path) if module.split(".")[0] in {"scanrig", "bench"}]
    assert not found or folder_of(path) == "cli", f"line {found[0]}"


MAY_OPEN = {
    "files/disk/reading.py": {"os.open", "open"},
    "files/disk/writing.py": {"os.open"},
    "files/disk/arrays.py": {"ZipFile", ".open"},
    "files/capture/images.py": {"mmap"},
    "vision/video.py": {"VideoCapture"},
    "cli/environment.py": {"os.open"},
    "cli/running.py": {"os.open"},
    "report/html.py": {".read_text"},
    "web/pages.py": {".read_bytes"},
    "facades.py": {"open"},
}
"""Files that open others by themselves: the door, what it writes with, archives behind it, videos whose
beginning was read through the door, the null device, our own."""
OPENERS = {"ZipFile", "memmap", "mmap", "imread", "genfromtxt", "VideoCapture"}


def openings(tree):
    """(how, line) of every call that opens a file for reading, or might."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        owner = getattr(getattr(node.func, "value", None), "id", "")
        if name == "open" and isinstance(node.func, ast.Name):
            modes = [*node.args[1:2], *(key.value for key in node.keywords if key.arg == "mode")]
            mode = modes[0].value if modes and isinstance(modes[0], ast.Constant) else "r"
            # A file that is made, appended to, or changed in place is one of our own.
            if not set(mode) & set("wxa+"):
                yield "open", node.lineno
        elif name == "open":
            yield "os.open" if owner == "os" else ".open", node.lineno
        elif name in ("read_bytes", "read_text"):
            yield f".{name}", node.lineno
        elif name in OPENERS or (name == "load" and owner in ("np", "numpy")):
            yield name, node.lineno


def test_openings_are_found():
    text = "open(a)\nopen(a, 'rb')\nopen(a, mode=m)\np.open()\nos.open(a, 0)\np.read_text()\nzipfile.ZipFile(a)\n"
    text += "np.load(a)\nopen(a, 'wb')\nopen(a, 'r+b')\njson.load(a)\n"
    found = list(openings(ast.parse(text)))
    assert [how for how, _ in found] == ["open"] * 3 + [".open", "os.open", ".read_text", "ZipFile", "load"]
    assert [line for _, line in found] == list(range(1, 9))


@for_every(FILES)
def test_files_are_opened_through_one_door(path):
    """`open_regular` waits for no pipe, reads no device, and bounds what it reads."""
    allowed = MAY_OPEN.get(str(path.relative_to(PACKAGE)), set())
    found = [(how, line) for how, line in openings(tree_of(path)) if how not in allowed]
    assert not found, f"line {found[0][1]}: {found[0][0]}, expected open_regular or read_bounded of jaxscan.files"


XML_PARSERS = {"xml.parsers", "xml.dom", "xml.sax.expatreader", "xml.sax.xmlreader", "lxml", "bs4", "defusedxml"}
XML_PARSERS |= {"html.parser", "xmltodict", "untangle", "pyexpat", "libxml2", "svgpathtools"}
XML_READINGS = {
    "fromstring",
    "fromstringlist",
    "iterparse",
    "XMLParser",
    "XMLPullParser",
    "XML",
    "XMLID",
    "ElementTree",
}
XML_READINGS |= {"FileStorage", "make_parser", "parseString", "ImageFile", "E57"}


def xml_readings(tree):
    """(how, line) of all that parses XML: modules of parsers, and functions of modules that also write it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            name = getattr(node, "attr", "") if isinstance(node, ast.Attribute) else ""
            owner = getattr(getattr(node, "value", None), "id", "")
            if name in XML_READINGS or (name == "parse" and owner.lower() in ("xml", "et", "elementtree", "sax")):
                yield name, node.lineno
            continue
        for name in names:
            known = any(name == one or name.startswith(f"{one}.") for one in XML_PARSERS)
            if known or name.rpartition(".")[2] in XML_READINGS - {"ElementTree"}:
                yield name, node.lineno


def test_readings_of_xml_are_found():
    text = "import lxml.etree\nfrom xml.parsers import expat\nxml.fromstring(a)\nxml.Element('a')\ncv2.FileStorage(a)\n"
    text += "ET.parse(a)\nimport xml.etree.ElementTree as xml\nfrom xml.etree.ElementTree import fromstring\n"
    assert sorted(line for _, line in xml_readings(ast.parse(text))) == [1, 2, 3, 5, 6, 8]


@for_every([*FILES, *RIG_FILES])
def test_xml_is_read_through_one_door(path):
    """`parse_xml` follows nothing that a file says; a parser that does sends a user's files to a stranger."""
    where = str(path.relative_to(ROOT))
    # libE57 writes; its ImageFile also reads, by Xerces.
    allowed = {"jaxscan/files/disk/xml.py": {"xml.parsers.expat"}, "jaxscan/files/clouds/e57.py": {"ImageFile"}}
    found = [one for one in xml_readings(tree_of(path)) if one[0] not in allowed.get(where, set())]
    assert not found, f"line {found[0][1]}: {found[0][0]}, expected parse_xml of jaxscan.files"
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "ImageFile":
            assert ast.unparse(node.args[1]) == "'w'", f"line {node.lineno}: libE57 only writes"


MAY_WRITE = {
    "jaxscan/files/disk/": {"os.open", "open", ".open", "os.mkdir", "os.makedirs", ".write_bytes", ".touch", "Part"},
    "jaxscan/project/catalogue.py": {"connect", "create_engine"},
    "jaxscan/cli/environment.py": {".mkdir"},
    "jaxscan/recalibration/judge/drift.py": {"Part"},
    "jaxscan/web/opening.py": {".touch", ".write_text"},
}
"""Places that write by themselves: the door, and what it hands out; the database, whose file is looked at and made
through the door before SQLite opens it; the folder of caches, which is made before any library is loaded and checked to
be the user's own; parts of something else; a page in a new folder that only this account can enter."""
MAKERS = {"mkdir", "makedirs", "symlink", "link", "mkfifo", "mknod", "truncate", "copy", "copy2", "copyfile"}
MAKERS |= {"copytree", "move", "save", "savez", "savez_compressed", "savetxt", "imwrite", "VideoWriter", "Part"}
MAKERS |= {"connect", "create_engine", "RotatingFileHandler", "FileHandler"}
OWNERS = {"os", "shutil", "np", "numpy", "cv2", "sqlite3", "logging"}
METHODS = {"write_text", "write_bytes", "touch", "mkdir", "symlink_to", "hardlink_to"}
HANDED = {"savefig", "saveas", "tofile", "ImageFile", "ZipFile", "memmap"}
"""Calls that write to the path that is their first argument."""
PARTS = {"partial_file", "partial_folder", "whole_folder"}
IN_MEMORY = {"BytesIO", "StringIO"}


def name_of(call):
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


def root_of(node):
    """The name at the beginning of an expression for a path: of `part / "a"`, `str(part)` and `part.parent.name`."""
    while not isinstance(node, ast.Name):
        if isinstance(node, ast.BinOp):
            node = node.left
        elif isinstance(node, ast.Call) and name_of(node) in {"str", "Path", "partial"} and node.args:
            node = node.args[0]
        else:
            return ""
    return node.id


def parts_of(node):
    """Names in a function that stand for a file in work, an opened file, or memory: nothing is opened by them."""
    arguments = node.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    found = {one.arg for one in every if getattr(one.annotation, "id", "") == "Part"}
    for inner in ast.walk(node):
        if isinstance(inner, ast.withitem) and isinstance(inner.context_expr, ast.Call):
            if name_of(inner.context_expr) in PARTS | {"open", "open_to_write"}:
                found.add(getattr(inner.optional_vars, "id", ""))
        elif isinstance(inner, ast.Assign) and isinstance(inner.value, ast.Call):
            if name_of(inner.value) in IN_MEMORY:
                found.update(getattr(target, "id", "") for target in inner.targets)
    return found - {""}


def mode_of(call, at):
    """The mode of an opening; None if it is none that writes."""
    modes = [*call.args[at : at + 1], *(key.value for key in call.keywords if key.arg == "mode")]
    if not modes:
        return None
    mode = modes[0].value if isinstance(modes[0], ast.Constant) else "w"
    return mode if isinstance(mode, str) and set(mode) & set("wax+") else None


def writings(node, parts=frozenset()):
    """(how, line) of every call that makes a file or folder, or opens one for writing, other than a file in work."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        parts = parts | parts_of(node)
    if isinstance(node, ast.Call):
        name, first = name_of(node), node.args[0] if node.args else None
        owner = getattr(node.func, "value", None)
        module = getattr(owner, "id", "") in OWNERS
        how, target = "", first
        if name == "open" and isinstance(node.func, ast.Name):
            how = "open" if mode_of(node, 1) else ""
        elif name == "open" and getattr(owner, "id", "") == "os":
            told = ast.unparse(node.args[1]) if len(node.args) > 1 else "O_CREAT"
            harmless = told == "os.O_RDONLY" or ast.unparse(first) == "os.devnull"
            how = "" if harmless else "os.open"
        elif name == "open":
            how, target = ".open" if mode_of(node, 0) or mode_of(node, 1) else "", owner
        elif name in METHODS and not module:
            how, target = f".{name}", owner
        elif name in HANDED:
            # Those that take a mode write only with one.
            reads = name in {"ImageFile", "ZipFile", "memmap"} and not mode_of(node, 1) and not mode_of(node, 2)
            how = "" if reads else name
        elif (name in MAKERS and module) or name == "Part":
            how = f"os.{name}" if getattr(owner, "id", "") == "os" else name
        elif name == "partial" and first is not None and getattr(first, "attr", "") in MAKERS | METHODS | {"open"}:
            how, target = first.attr, None
        if how and (target is None or root_of(target) not in parts):
            yield how, node.lineno
    for child in ast.iter_child_nodes(node):
        yield from writings(child, parts)


def test_writings_are_found():
    ways = (
        "open(a, 'w')", "open(a, mode='r+b')", "open(a, m)", "os.open(a, os.O_RDWR)", "os.open(a, b)", "a.open('x')",
        "a.write_text('')", "(a / 'b').mkdir()", "os.makedirs(a)", "a.symlink_to(b)", "shutil.copy(b, a)", "a.touch()",
        "np.save(a, x)", "np.savez(str(a), x=x)", "ZipFile(a, 'w')", "cv2.imwrite(a, x)", "figure.savefig(a)",
        "sqlite3.connect(a)", "partial(sqlite3.connect, a)", "Part(a)",
    )  # fmt: skip
    text = "\n".join(ways)
    assert [line for _, line in writings(ast.parse(text))] == list(range(1, len(ways) + 1))
    inside = (
        "def f(a: {kind}):\n    open(a, 'w')\n    (a / 'b').write_bytes(b'')\n    def g():\n        np.save(a, x)\n"
    )
    assert len(list(writings(ast.parse(inside.format(kind="Path"))))) == 3
    assert not list(writings(ast.parse(inside.format(kind="Part"))))
    harmless = (
        "def f():\n    b = io.BytesIO()\n    figure.savefig(b)\n    open(c)\n    os.open(os.devnull, os.O_RDWR)\n"
    )
    harmless += (
        "    os.open(a, os.O_RDONLY)\n    ZipFile(c)\n    with whole_folder(a) as d:\n        (d / 'e').touch()\n"
    )
    assert not list(writings(ast.parse(harmless)))


@for_every([*FILES, *RIG_FILES], lambda path: str(path.relative_to(ROOT)))
def test_files_are_written_through_one_door(path):
    """`open_to_write` and `make_folder` follow no link; writers that are handed a file in work take a `Part`."""
    where = str(path.relative_to(ROOT).as_posix()).removeprefix("hardware/")
    allowed = set().union(*(ways for start, ways in MAY_WRITE.items() if where.startswith(start)))
    found = [(how, line) for how, line in writings(tree_of(path)) if how not in allowed]
    told = ", ".join(f"line {line}: {how}" for how, line in found)
    assert not found, f"{told}, expected open_to_write, make_folder, or a path that is a Part"


@for_every([p for p in FILES if folder_of(p) == "files"])
def test_a_name_that_is_too_long_is_no_surprise(path):
    """`Path.exists` and its like raise for such names; `os.path.exists` says no, and the opening says why."""
    # Entries of a folder have names that exist.
    allowed = {"files/recording.py", "files/capture/journal.py", "files/importing/sources.py"}
    if str(path.relative_to(PACKAGE)) in allowed:
        return
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            safe = isinstance(node.func.value, ast.Attribute) and node.func.value.attr == "path"
            names = {"exists", "is_file", "is_dir", "is_symlink"}
            assert safe or node.func.attr not in names, f"line {node.lineno}: {node.func.attr}"


def test_the_acquisition_layer_asserts_nothing():
    for path in RIG_FILES:
        found = [node.lineno for node in ast.walk(tree_of(path)) if isinstance(node, ast.Assert)]
        assert not found, f"{path.name}: line {found[0]}"


@for_every([p for p in FILES if folder_of(p) in CORE])
def test_the_core_does_no_io(path):
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"print", "open", "input"}, f"line {node.lineno}: {node.func.id}"
    for module, line in imports(path):
        assert module.split(".")[0] not in {"pathlib", "shutil", "io", "sys"}, f"line {line}: {module}"


@for_every(FILES)
def test_no_library_code_asserts_or_configures_jax(path):
    tree = tree_of(path)
    assert not [n.lineno for n in ast.walk(tree) if isinstance(n, ast.Assert)]
    if folder_of(path) != "cli":
        assert "jax.config.update" not in path.read_text()


@pytest.fixture(scope="module")
def imported():
    """What a process of its own says that has imported the package: a line on modules, one on JAX."""
    heavy = (
        "aiohttp",
        "cv2",
        "embreex",
        "serial",
        "matplotlib",
        "pye57",
        "laspy",
        "scanrig",
        "open3d",
        "fast_simplification",
        "distributed",
    )
    code = (
        "import sys, jaxscan; print([m for m in ('jax', 'numpy', 'pydantic') if m in sys.modules])\n"
        f"from jaxscan import *; print([m for m in {heavy} if m in sys.modules])\n"
        "import jax; print(jax.config.jax_enable_x64, jax.config.jax_compilation_cache_dir)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


def test_import_loads_nothing(imported):
    assert imported[0] == "[]"


def test_no_public_name_loads_what_only_some_need(imported):
    assert imported[1] == "[]"


def test_import_configures_nothing(imported):
    assert imported[2].split() == ["False", "None"]
