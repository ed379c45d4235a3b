"""Files of a stranger that name other files and addresses: no reader asks for them, by what the kernel is asked."""

import json
import os
import re
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from jaxscan.files.clouds import WRITERS, save_cloud
from tests.files.clouds import make_cloud
from tests.files.e57s import with_xml, xml_of


pytestmark = pytest.mark.rig


ADDRESS = "http://127.0.0.1:9/asked-for"
TREES = [
    *(sys.prefix, sys.base_prefix, Path(jaxscan.__file__).parent, Path(jaxscan.__file__).parents[1] / "hardware"),
    *("/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/share/locale", "/usr/share/zoneinfo"),
    *("/usr/share/fonts", "/sys/devices", "/sys/bus/pci", "/sys/fs/cgroup", "/proc/sys/crypto"),
    os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"),
]
"""Folders of the program itself: interpreter, environment, package, libraries, fonts, caches, kind of machine."""
FILES = [
    *(
        "/etc/ld.so.cache",
        "/etc/ld.so.preload",
        "/etc/localtime",
        "/etc/locale.alias",
        "/etc/ssl/openssl.cnf",
        "/dev/null",
        "/dev/urandom",
    ),
    *(f"/proc/{name}" for name in ("cpuinfo", "meminfo", "stat", "self/cgroup", "self/maps")),
]
"""Single files that it may read. Folders on the path of modules are listed, and no more."""


@pytest.fixture(scope="module")
def strace():
    """The program, which sees what libraries in C do too."""
    found = shutil.which("strace")
    if found is None:
        if os.environ.get("JAXSCAN_REQUIRE_BENCH"):
            pytest.fail("strace is missing: make bench-deps")
        pytest.skip("needs strace: make bench-deps")
    return found


def traced(strace, folder, code, *words):
    """What a process and its children ask of the kernel: (lines that reach out over a network, opened files, the run).

    A library may look, while it is imported, whether there are sockets of IPv6; it asks nobody.
    """
    log = folder.parent / f"{folder.name}.trace"
    told = [strace, "-f", "-y", "-qq", "-s", "4096", "-e", "trace=network,open,openat,openat2", "-o", log]
    ran = subprocess.run([*told, sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True)
    lines = log.read_text().splitlines()
    sockets = [line for line in lines if re.search(r"\b(connect|send\w+)\(.*AF_(INET|PACKET|VSOCK)", line)]
    opened = [found for line in lines if (found := OPENED.search(line))]
    assert opened, ran.stderr
    return sockets, opened, ran


OPENED = re.compile(r'\bopen(?:at2?)?\((?:[^"<]*<([^>]*)>[^"]*)?"([^"]*)"(?:.*= \d+<(.*)>$)?')
"""With -y: the folder from which a name counts, the name, and the file that was found at the end of all links."""


def strays(opened, folder):
    """Files that a process in a folder opened, or wanted to, that are neither in the folder nor the program's own."""
    asked = {os.path.join(one[1] or folder, one[2]) for one in opened}
    found = {one[3] for one in opened if one[3]}
    real = {os.path.realpath(path) for path in map(str, (folder, *TREES))}
    trees = tuple(f"{path.rstrip('/')}/" for path in {*map(str, (folder, *TREES)), *real})
    single = {*FILES, *(os.path.abspath(path) for path in sys.path), *map(os.path.realpath, sys.path)}
    # The kernel has a number for "self".
    paths = {re.sub(r"^/proc/[0-9]+/", "/proc/self/", os.path.normpath(path)) for path in asked | found}
    return sorted(path for path in paths if not f"{path}/".startswith(trees) and path not in single)


def test_the_trace_sees_sockets_and_files(strace, tmp_path):
    (tmp_path / "secret.txt").write_text("sk")
    code = "import socket; open('secret.txt'); socket.socket().connect_ex(('127.0.0.1', 9))"
    sockets, opened, _ = traced(strace, tmp_path, code)
    assert sockets and "secret.txt" in [one[2] for one in opened]


@pytest.mark.parametrize(
    "name", ["../secret.txt", "link.txt", "{outside}/none.txt", "/etc/passwd", "/proc/self/environ", "../stranger2/a"]
)
def test_the_trace_sees_files_elsewhere(strace, tmp_path, name):
    """By a path, by a link, and those that are not there."""
    folder = tmp_path / "stranger"
    folder.mkdir()
    (tmp_path / "secret.txt").write_text("sk")
    (folder / "link.txt").symlink_to("../secret.txt")
    (folder / "own.txt").write_text("own")
    name = name.format(outside=tmp_path)
    code = "import os, sys; open('own.txt'); os.path.exists(sys.argv[1]); os.open(sys.argv[1], os.O_RDONLY)"
    _, opened, _ = traced(strace, folder, code, name)
    wanted = os.path.realpath(folder / name) if "proc" not in name else name
    assert strays(opened, folder) == [wanted]


RUN = """
import json, os, sys
import jaxscan.api, jaxscan.files.clouds
from jaxscan.cli.main import main
for words in json.loads(sys.argv[1]):
    # The command ends its process. One for each order; what they import is loaded once.
    child = os.fork()
    if child == 0:
        sys.argv = ["jaxscan", *words]
        try:
            main()
        except SystemExit as ended:
            os._exit(ended.code or 0)
        os._exit(0)
    print(words, "code", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def doctype(secret):
    return (
        f'<!DOCTYPE e57Root [<!ENTITY % d SYSTEM "{ADDRESS}"> %d; <!ENTITY s SYSTEM "file://{secret}">'
        f'<!ENTITY n SYSTEM "{ADDRESS}">]>'
    )


def hostile_clouds(folder, secret):
    """A cloud of every format whose texts name other files and addresses, and of E57 those in other encodings."""
    made = {}
    for suffix in WRITERS:
        save_cloud(make_cloud(), folder / f"good{suffix}")
        data = (folder / f"good{suffix}").read_bytes()
        (folder / f"good{suffix}").unlink()
        made[f"plain{suffix}"] = data
        made[f"xml{suffix}"] = f'<?xml version="1.0"?>{doctype(secret)}<a>&s;</a>'.encode()
        made[f"lead{suffix}"] = f"include {secret}\nfile://{secret}\n{ADDRESS}\n".encode() + data
    data = made["plain.e57"]
    xml = xml_of(data).decode()
    text = xml.replace("<e57Root", f"{doctype(secret)}<e57Root").replace("</e57Root>", "&s;&n;</e57Root>")
    ebcdic = text.replace('encoding="UTF-8"', 'encoding="ebcdic-cp-us"')
    lone = text[text.index("<!DOCTYPE") :]
    external = xml.replace("<e57Root", f'<!DOCTYPE e57Root SYSTEM "{ADDRESS}"><e57Root')
    schema = xml.replace(
        "<e57Root", f'<e57Root xmlns:i="http://www.w3.org/2001/XMLSchema-instance" i:schemaLocation="a {ADDRESS}"'
    )
    include = xml.replace(
        "</e57Root>", f'<x:include xmlns:x="http://www.w3.org/2001/XInclude" href="{secret}"/></e57Root>'
    )
    made["entities.e57"] = with_xml(data, text.encode())
    made["ebcdic.e57"] = with_xml(data, ebcdic.encode("cp037"))
    made["utf16.e57"] = with_xml(data, text.replace('"UTF-8"', '"UTF-16"').encode("utf-16"))
    made["external.e57"] = with_xml(data, external.encode())
    made["schema.e57"] = with_xml(data, schema.encode())
    made["include.e57"] = with_xml(data, include.encode())
    made["edge.e57"] = with_xml(data, lone.encode(), place=1022)
    made["deep.e57"] = with_xml(
        data, xml.replace("</e57Root>", "<a>" * 200_000 + "</a>" * 200_000 + "</e57Root>").encode()
    )
    return made


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def hostile_pictures(secret):
    """XMP with entities in a PNG and a JPEG, and pictures that are another kind of file."""
    import cv2

    xmp = f'<?xml version="1.0"?>{doctype(secret)}<x:xmpmeta>&s;&n;</x:xmpmeta>'.encode()
    image = np.full((64, 128, 3), 99, np.uint8)
    png, jpeg = (cv2.imencode(suffix, image)[1].tobytes() for suffix in (".png", ".jpg"))
    packet = b"http://ns.adobe.com/xap/1.0/\0" + xmp
    svg = f'<svg xmlns="http://www.w3.org/2000/svg">{doctype(secret)}<image href="{ADDRESS}"/></svg>'.encode()
    playlist = f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{ADDRESS}\nfile://{secret}\n".encode()
    return {
        "xmp.png": png[:33] + chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + xmp) + png[33:],
        "xmp.jpg": jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(packet) + 2) + packet + jpeg[2:],
        "svg.png": svg,
        "list.avi": playlist,
        "concat.mp4": f"ffconcat version 1.0\nfile {secret}\nfile {ADDRESS}\n".encode(),
        "dash.mkv": f'<?xml version="1.0"?>{doctype(secret)}<MPD><BaseURL>{ADDRESS}</BaseURL></MPD>'.encode(),
    }


def hostile_settings(secret):
    """Cameras, boards, projects and targets with includes, tags and document types."""
    xml = (
        f'<?xml version="1.0"?>{doctype(secret)}<opencv_storage><camera_matrix>&s;&n;</camera_matrix></opencv_storage>'
    )
    yaml = f"%YAML:1.0\n---\ncamera_matrix: !include {secret}\nbase: !!python/object/apply:os.system [ls]\n"
    yaml += f"url: {ADDRESS}\n"
    toml = f'include = "{secret}"\nurl = "{ADDRESS}"\n'
    return {
        "camera.xml": xml.encode(),
        "camera_xml.yaml": xml.encode(),
        "camera.yaml": yaml.encode(),
        "camera.json": json.dumps({"$ref": ADDRESS, "include": str(secret)}).encode(),
        "camera.cameramodel": f"# include {secret}\n{{'lensmodel': 'LENSMODEL_SPLINED', 'a': '{ADDRESS}'}}".encode(),
        **{f"{name}.toml": toml.encode() for name in ("project", "targets", "board", "rig")},
    }


def test_no_reader_asks_for_another_file_or_address(strace, tmp_path):
    folder, secret = tmp_path / "stranger", tmp_path / "secret.txt"
    folder.mkdir()
    secret.write_text("sk-secret-4711\n")
    clouds, pictures, settings = hostile_clouds(folder, secret), hostile_pictures(secret), hostile_settings(secret)
    for name, data in {**clouds, **pictures, **settings}.items():
        (folder / name).write_bytes(data)
    (folder / "images").mkdir()
    for name in ("xmp.png", "xmp.jpg"):
        (folder / "images" / name).write_bytes(pictures[name])
    orders = [["convert", name, f"out-{name}.xyz"] for name in clouds]
    orders += [["measure", "room", "entities.e57"], ["report", "entities.e57", "-o", "out.html"]]
    orders += [["align", "plain.ply", "-o", "out.ply", "--targets", "targets.toml"]]
    orders += [["convert", name, "out.yaml"] for name in settings if name.startswith("camera")]
    orders += [["board", "board.toml", "-o", "out.pdf"], ["project", "status", "project.toml"]]
    orders += [["simulate", "rig.toml", "-o", "out-sweep"]]
    orders += [
        ["import", name, "-o", f"out-{name}"] for name in ("images", "list.avi", "concat.mp4", "dash.mkv", "svg.png")
    ]
    sockets, opened, ran = traced(strace, folder, RUN, json.dumps(orders))
    assert ran.stdout.count(" code ") == len(orders), ran.stdout + ran.stderr
    assert "['convert', 'plain.e57', 'out-plain.e57.xyz'] code 0" in ran.stdout
    assert "['convert', 'entities.e57', 'out-entities.e57.xyz'] code 1" in ran.stdout
    assert not sockets, sockets[:3]
    assert not [one[2] for one in opened if one[2].endswith("secret.txt") or "asked-for" in one[2]]
    elsewhere = strays(opened, folder)
    assert not elsewhere, elsewhere
    for path in folder.rglob("out*"):
        assert path.is_dir() or b"sk-secret" not in path.read_bytes()
