"""The scenes in code: name -> function of a seed. See docs/scenes.md for what each shows.

Training and held-out scenes share no function that makes a shape or a texture: `train_*` and `heldout_*` modules
never import each other. What both use is array maths: `mesh` (normals, joining), `motion` (matrices, paths), `finish`
(arrays to materials) and `skies` (a clear dome, a lit room).
"""

from collections.abc import Callable

from framecast.render.heldout_clockwork import clockwork
from framecast.render.heldout_greenhouse import greenhouse
from framecast.render.heldout_hangar import hangar
from framecast.render.heldout_harbor import harbor
from framecast.render.heldout_pond import pond
from framecast.render.scene import Scene
from framecast.render.train_courtyard import courtyard
from framecast.render.train_forest import forest
from framecast.render.train_medley import medley
from framecast.render.train_neon import neon
from framecast.render.train_rooms import gallery, workshop
from framecast.render.train_tramway import tramway

SCENES: dict[str, Callable[[int], Scene]] = {
    "courtyard": courtyard,
    "workshop": workshop,
    "gallery": gallery,
    "tramway": tramway,
    "neon": neon,
    "forest": forest,
    "medley": medley,
    "harbor": harbor,
    "greenhouse": greenhouse,
    "hangar": hangar,
    "clockwork": clockwork,
    "pond": pond,
}

TRAIN = ("courtyard", "workshop", "gallery", "tramway", "neon", "forest", "medley")
TEST = ("harbor", "greenhouse", "hangar", "clockwork", "pond")
"""The split; the same as each scene's own `split`, without building it."""
