"""Pictures of rigs that are yet to be built."""

from jaxscan.report.design.sigma_plot import design_picture
