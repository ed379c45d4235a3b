"""The surfaces of the simulated room, ray casting, and the room's light."""

from jaxscan.simulation.scene.caster import Caster
from jaxscan.simulation.scene.edges import Cone, points_on
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.plane import Plane, Rays
from jaxscan.simulation.scene.scene import Scene, build_scene, make_scene, room_from_scanner
from jaxscan.simulation.scene.textures import Material, stripes
