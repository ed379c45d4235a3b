"""Which of the candidates of a line is the stripe."""

from jaxscan.stripes.choosing.by_steps import chosen_of, pick_by_steps
from jaxscan.stripes.choosing.on_lines import choose_stripes
