"""Many captures as one project: the products of each, and which of them are there already."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.project.batch import Report, default_workers, run_batch
    from jaxscan.project.begin import board_notes, project_text
    from jaxscan.project.catalogue import Catalogue, Row, open_catalogue
    from jaxscan.project.compare import Comparison, LengthChange, compare_projects
    from jaxscan.project.config import Product, ProjectFile, load_project_file
    from jaxscan.project.project import Project, ProjectCapture, check_owner, claimed, load_project
    from jaxscan.project.steps import (
        Opened,
        State,
        Status,
        Step,
        code_digest,
        digest_of,
        digests_of,
        opened,
        parts_of,
        states_of,
        steps_of,
    )
    from jaxscan.project.work import begun_row, do_step, failed_row
else:
    load_on_use(__name__)
