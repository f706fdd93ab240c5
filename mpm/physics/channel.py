"""Coulomb friction of the two side walls of a channel on a flow in 2D.

Walls at a distance W, with friction coefficient mu, carry the flow's out-of-plane stress and brake it by

    f = -2 mu / W max(-sigma_zz, 0) v / |v|     per volume

over its whole depth (as in Taberlet et al. 2003; Jop, Forterre & Pouliquen 2006). Particles sum up at a node the
largest possible friction, N_i = sum_p w_ip V0 (2 mu / W) max(-sigma_zz, 0). After forces and surfaces have acted, the
node's velocity decreases by at most dt N_i / m_i, or to zero: material at rest stays at rest
(`mpm.physics.grid.moved_node`).
"""

import taichi as ti

from mpm.arrays.access import maximum


@ti.func
def side_friction(stress: ti.template(), volume, grip):
    """Largest friction of the side walls on a particle [N per metre of width], from `grip` = 2 mu / W [1/m]."""
    return volume * grip * maximum(0.0 - stress[2], 0.0)
