"""The formats of clouds by suffix; a light file, from which the helps of the command line are made."""

FORMATS = {
    ".ply": "ply",
    ".npz": "npz",
    ".e57": "e57",
    ".las": "las",
    ".laz": "las",
    ".pcd": "pcd",
    ".xyz": "xyz",
    ".ptx": "ptx",
}
"""The file beside this one that holds a format's `write_<name>` (cloud, path, about) and `read_<name>` (file, reading).
To add a format: such a file, and a line here."""
