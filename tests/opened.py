"""A project opened as the verbs open it, and done in this process."""

from jaxscan.project import do_step, load_project, open_catalogue, opened


def catalogue_of(file):
    project = load_project(file)
    project.output.mkdir(exist_ok=True)
    return open_catalogue(project)


def states(file):
    """The state of every step, by key."""
    with opened(load_project(file)) as found:
        return {status.step.key: status for status in found.states}


def work(file):
    """Do all that is not done, one after the other; returns the rows."""
    catalogue, rows = catalogue_of(file), []
    for status in states(file).values():
        if status.state != "done":
            rows.append(do_step(status, load_project(file).output))
            catalogue.write(rows[-1:])
    catalogue.close()
    return rows


def edit(file, old, new):
    """Replace words of the project's file."""
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def products(file):
    """The bytes of every product, by its path."""
    folder = load_project(file).output
    kinds = ("calibrations", "clouds", "measures", "meshes", "plans", "panoramas", "reports", "groups")
    paths = [path for kind in kinds for path in (folder / kind).rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}
