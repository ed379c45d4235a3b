"""Pictures of rigs that are yet to be built."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report.design.sigma_plot import design_picture
else:
    load_on_use(__name__)
