"""Where on a line the stripe may be: the highest maxima of matched filters."""

from jaxscan.stripes.search.candidates import CANDIDATES, Candidates, Located, reach
from jaxscan.stripes.search.locate import locate
from jaxscan.stripes.search.planes import Planes, host_planes, read_planes, sample_pair
from jaxscan.stripes.search.search import (
    LineGate,
    Search,
    correct_search,
    learn_search,
    noise_of,
    prepare_search,
    whole_lines,
)
from jaxscan.stripes.search.speckle import REASONS
from jaxscan.stripes.search.widths import LEARNED_FRAMES
