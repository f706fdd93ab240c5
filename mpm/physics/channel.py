"""Coulomb friction of the two side walls of a channel on a flow in 2D.

Walls W apart, with the coefficient mu, press on the flow with its own stress across the plane and brake it by

    f = -2 mu / W max(-sigma_zz, 0) v / |v|     per volume

on all of its depth (of the kind of Taberlet et al. 2003; Jop, Forterre & Pouliquen 2006). Particles give a node the
most that friction can take, N_i = sum_p w_ip V0 (2 mu / W) max(-sigma_zz, 0); of the velocity that forces and surfaces
have left it, the node then loses at most dt N_i / m_i, and stops where that is more: what stands, stays
(`mpm.physics.grid.moved_node`).
"""

import taichi as ti

from mpm.arrays.access import maximum


@ti.func
def side_friction(stress: ti.template(), volume, grip):
    """The most that side walls brake a particle with [N per metre of width], from `grip` = 2 mu / W [1/m]."""
    return volume * grip * maximum(0.0 - stress[2], 0.0)
