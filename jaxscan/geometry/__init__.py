"""Nouns: what the rig is."""

from jaxscan.geometry.arrays import Array as Array
from jaxscan.geometry.board import AbstractBoard as AbstractBoard
from jaxscan.geometry.board import Charuco as Charuco
from jaxscan.geometry.board import Chessboard as Chessboard
from jaxscan.geometry.camera import AbstractCamera as AbstractCamera
from jaxscan.geometry.camera import Pinhole as Pinhole
from jaxscan.geometry.fisheye import Fisheye as Fisheye
from jaxscan.geometry.fit import AxisFit as AxisFit
from jaxscan.geometry.fit import PlaneFit as PlaneFit
from jaxscan.geometry.fit import fit_axis as fit_axis
from jaxscan.geometry.fit import fit_plane as fit_plane
from jaxscan.geometry.fit import plane_sigma as plane_sigma
from jaxscan.geometry.laser import LaserSheet as LaserSheet
from jaxscan.geometry.laser import stack_lasers as stack_lasers
from jaxscan.geometry.rigid import exponential as exponential
from jaxscan.geometry.rigid import invert as invert
from jaxscan.geometry.rigid import rigid as rigid
from jaxscan.geometry.rigid import transform as transform
from jaxscan.geometry.scanner import Scanner as Scanner
from jaxscan.geometry.scanner import point_up as point_up
from jaxscan.geometry.stripe_axis import StripeAxis as StripeAxis
from jaxscan.geometry.stripe_axis import across_and_along as across_and_along
from jaxscan.geometry.stripe_axis import stripe_pixel as stripe_pixel
from jaxscan.geometry.turntable import Turntable as Turntable
