"""Configuration of the camera: its lens, its image and its sensor."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from jaxscan.geometry import MAX_PIXELS
from jaxscan.simulation.settings.numbers import Distance, Focal, Level, Number, Pair, Pixels, Section, Share, Size


PixelFormat = Literal["mono8", "rgb8", "bayer_rggb8", "bayer_bggr8", "bayer_grbg8", "bayer_gbrg8"]


# The simulator has its own lens models, so that an error of the estimator's shows; only the names of
# lenses and coefficients are shared with the estimator.
_COEFFICIENTS: dict[str, tuple[str, ...]] = {
    "pinhole": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
    "double_sphere": ("xi", "alpha"),
}


class CameraSpec(Section):
    """Pinhole with Brown-Conrady distortion, fisheye after Kannala and Brandt, or double sphere [px; 1]."""

    model: Literal["pinhole", "fisheye", "double_sphere"] = "pinhole"
    width: Size = 1280
    height: Size = 1024
    fx: Focal = 1100.0
    fy: Focal = 1100.0
    cx: Number | None = None
    """Principal point; the middle of the image where not given."""
    cy: Number | None = None
    k1: Number = 0.0
    """This and the other coefficients are those of the model; all others stay 0."""
    k2: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0
    k3: Number = 0.0
    k4: Number = 0.0
    xi: Number = 0.0
    alpha: Number = 0.0
    field_deg: Annotated[float, Field(ge=1, le=300)] = 200.0
    """Field of view of a wide-angle lens: the image is dark beyond."""
    up: Literal["-v", "+v", "+u", "-u"] = "-v"

    @model_validator(mode="after")
    def _one_lens(self) -> "CameraSpec":
        every = dict.fromkeys(name for names in _COEFFICIENTS.values() for name in names)
        strange = [name for name in every if name not in _COEFFICIENTS[self.model]]
        if any(getattr(self, name) != 0.0 for name in strange):
            raise ValueError(f"a {self.model} has no {' or '.join(strange)}")
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(f"{self.width} x {self.height} px are more than {MAX_PIXELS // 1_000_000} megapixels")
        return self

    @property
    def wide(self) -> bool:
        """Whether the lens sees beside itself: rays are then found over the angle to the axis."""
        return self.model != "pinhole"

    def coefficients(self) -> dict[str, float]:
        """Coefficients of the lens, by name."""
        return {name: getattr(self, name) for name in _COEFFICIENTS[self.model]}

    def centre(self) -> Pair:
        """Principal point [px]."""
        return (
            (self.width - 1) / 2 if self.cx is None else self.cx,
            (self.height - 1) / 2 if self.cy is None else self.cy,
        )


class SensorSpec(Section):
    """The sensor: response and noise."""

    pixel_format: PixelFormat = "mono8"
    response: Annotated[str, Field(pattern=r"^(linear|srgb|gamma [1-4](\.\d{1,6})?)$")] = "linear"
    """"linear", "srgb", or "gamma 2.2": code = 255 (level / 255)^(1 / 2.2)."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """The images are compressed to JPEGs of this quality and unpacked again; None: they are not."""
    stated: bool = True
    """Whether the captures' headers tell response and compression; else they say, as those of strangers do: linear."""
    psf_px: Pixels = 0.7
    """Standard deviation of the lens's Gaussian point-spread function."""
    electrons_per_dn: Level = 40.0
    """Conversion gain of the linear signal; shot noise is its square root in electrons."""
    read_dn: Annotated[float, Field(ge=0, le=1e3)] = 1.0
    """Standard deviation of the read noise, in DN of the linear signal."""
    crosstalk: Share = 0.04
    """Share of the laser's light that the other two channels of a colour camera see."""
    black_dn: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Level that the sensor adds to everything, in DN of the linear signal."""
    pixel_um: Annotated[float, Field(ge=0.5, le=50)] = 3.45
    """Side of a pixel: with the aperture and the laser's wavelength it says how large grains of speckle are."""
    f_number: Annotated[float, Field(ge=0.7, le=64)] = 4.0
    """Working f-number of the lens."""
    gain_spread: Share = 0.0
    """Standard deviation of the gain from pixel to pixel, relative; the same in all frames."""
    offset_spread_dn: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of the pixels' own offsets."""
    hot_pixels: Share = 0.0
    """Share of the pixels that have a dark current."""
    hot_dn: Annotated[float, Field(ge=0, le=1e3)] = 40.0
    """Its mean; it is distributed exponentially."""
    vignetting: Share = 0.0
    """Share of the light that is lost in the farthest corner; it grows with the square of the distance from the
    principal point."""
    psf_edge: Annotated[float, Field(ge=0, le=5)] = 0.0
    """How much wider the blur is in the farthest corner, as a share of `psf_px`."""
    focus_m: Distance = 2.0
    """Depth at which the lens is sharp."""
    defocus_px_m: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Blur by defocus, in px for each 1/m of difference to `focus_m`; it adds to `psf_px` in variance."""
