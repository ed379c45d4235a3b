"""The stripes of measured candidates, on the lines of the image."""

import jax
import jax.numpy as jnp
from jaxtyping import Int8

from jaxscan.geometry import Array
from jaxscan.stripes.choosing.rules import choose
from jaxscan.stripes.search import Search
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes, MeasuredLines


def choose_stripes(
    found: MeasuredLines, search: Search, setup: ExtractionSetup
) -> tuple[FrameStripes, Int8[Array, "frames lines"] | None]:
    """Choose among the candidates of each line, and put them on the lines of the image; pure and traceable.

    Returns:
        stripes: A profile per frame; with `all_candidates` one for each candidate.
        chosen: Number of each line's stripe among all candidates, -1 where there is none; None where
            one candidate is given, or nothing is chosen (`settings.choice` "all").
    """
    sites, settings = setup.sites, setup.settings
    lines, slots = setup.plane_size[0], jnp.asarray(found.slots)

    def candidates_at(index):
        place = jnp.where(index >= 0, index, 0)
        values = jax.tree.map(lambda field: field.at[place].get(mode="promise_in_bounds"), found.measured)
        return values._replace(valid=(index >= 0) & values.valid)

    candidates = candidates_at(slots)
    usable = jnp.where(candidates.valid, slots, -1)
    number = None if settings.choice == "all" else choose(candidates, search.near_side, settings)
    if number is None or setup.several:
        taken = jnp.moveaxis(usable, 2, 1).reshape(-1, lines)
    else:
        taken = jnp.full(number.shape, -1, slots.dtype)
        for k in range(slots.shape[2]):
            taken = jnp.where(number == k, usable[:, :, k], taken)
        number = None
    stripes = candidates_at(taken)
    offsets = jnp.asarray(sites.offsets, jnp.float32)[jnp.arange(lines) % len(sites.offsets)]
    stripes = stripes._replace(u=stripes.u + offsets[None, :])
    stripes = jax.tree.map(lambda field: jnp.where(taken >= 0, field, jnp.zeros_like(field)), stripes)

    def on_image_lines(values, nothing=0):
        if setup.image_lines == lines:
            return values
        image = jnp.full((len(values), setup.image_lines), nothing, values.dtype)
        last = sites.first_line + sites.line_step * lines
        return image.at[:, sites.first_line : last : sites.line_step].set(values)

    return jax.tree.map(on_image_lines, stripes), None if number is None else on_image_lines(number, -1)
