"""Scenes whose solids are baffles alone, as formats of other codes require, or terrain as well, as a surrogate does."""

from datasets.errors import InputError
from datasets.scene import Scene


def check_plain(scene: Scene, who: str, where: str = "", *, terrain: bool = False) -> None:
    """Raise InputError for a scene with solids, turned baffles or open sides, which `who` does not know.

    terrain: whether it knows terrain under Coulomb friction, and turned baffles.
    """
    for index, solid in enumerate(scene.solids if terrain else ()):
        if solid.kind != "terrain":
            message = f"expected terrain, {who} knows no other solids but baffles, got a {solid.kind}"
            raise InputError(message, where=where, key=f"solids[{index}].kind")
        if solid.contact != "coulomb" or solid.adhesion > 0.0:
            message = f"expected Coulomb friction alone, {who} knows no other contact"
            raise InputError(message, where=where, key=f"solids[{index}].contact")
    if scene.solids and not terrain:
        raise InputError(f"expected a scene without solids, {who} knows baffles alone", where=where, key="solids")
    for index, baffle in enumerate(() if terrain else scene.baffles):
        if baffle.turned_deg != 0.0:
            message = f"expected a baffle along the axes, {who} knows no other"
            raise InputError(message, where=where, key=f"baffles[{index}].turned_deg")
    if scene.open_sides:
        raise InputError(f"expected a closed box, {who} knows no other", where=where, key="open_sides")
