"""The surfaces of the simulated room, ray casting, and the room's light."""

from jaxscan.simulation.scene.meshes import Caster, Mesh
from jaxscan.simulation.scene.scene import Cone, Scene, build_scene, make_scene, points_on, room_from_scanner
from jaxscan.simulation.scene.textures import Material, stripes
