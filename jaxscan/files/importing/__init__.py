"""Import of images and videos of other programs as captures."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.importing.plan import ImportPlan, ImportRequest, PlannedRecord, Row
    from jaxscan.files.importing.sources import Source, list_images, parse_board
    from jaxscan.files.importing.write import ImageSettings, ImportedHeader, describe_images, make_plan, write_import
else:
    load_on_use(__name__)
