"""Geometry of the rig: cameras, laser sheets, motions, scanner, boards."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.geometry.arrays import MAX_PIXELS, Array, namespace
    from jaxscan.geometry.boards import (
        DICTIONARIES,
        AbstractBoard,
        AprilGrid,
        BoardPicture,
        BowedBoard,
        Charuco,
        Chessboard,
        Circles,
        bend_functions,
        check_board,
        corner_frame,
        known_dictionary,
    )
    from jaxscan.geometry.cameras import CAMERAS, AbstractCamera, CameraModel, DoubleSphere, Fisheye, Pinhole
    from jaxscan.geometry.fit import (
        MEDIAN_TO_SIGMA,
        AxisFit,
        PlaneFit,
        PrincipalAxes,
        apply_homography,
        direct_homography,
        fit_axis,
        fit_plane,
        fixes_plane,
        median_sigma,
        plane_sigma,
        principal_axes,
        root_of,
        square_root,
    )
    from jaxscan.geometry.kinematics import lit_points, lit_slopes, pixels, points, poses, rays, slopes
    from jaxscan.geometry.laser import LaserSheet, stack_lasers
    from jaxscan.geometry.motion_kinds import MOTIONS, Carries
    from jaxscan.geometry.motions import (
        AbstractMotion,
        Hand,
        LinearStage,
        Still,
        Turntable,
        carrying,
        motion_class,
        motion_of,
    )
    from jaxscan.geometry.parameters import ParameterBlock
    from jaxscan.geometry.plausible import Doubt, camera_doubts, scanner_doubts
    from jaxscan.geometry.rig import Layout, Rig, make_layout
    from jaxscan.geometry.rigid import (
        compose,
        exponential,
        from_quaternion,
        invert,
        is_pose,
        nearest_rotation,
        quaternion,
        rigid,
        rotation_vectors,
        transform,
        turn,
    )
    from jaxscan.geometry.scanner import Scanner, point_up
    from jaxscan.geometry.stripe_axis import StripeAxis, across_and_along, stripe_pixel
else:
    load_on_use(__name__)
