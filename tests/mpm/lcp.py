"""The backward Euler return as a linear complementarity problem, solved by trying every set of active surfaces.

For the six planes F_ij of Mohr-Coulomb and the three of the cutoff, with normals n_a, flows m_a and elasticity D:

    s = s_trial - sum_a g_a D m_a,    g >= 0,  n_a s <= k_a,  g_a (n_a s - k_a) = 0

A solution has at most three linearly independent active surfaces (de Souza Neto, Peric & Owen 2008, section 8.2).
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from datasets.material import Material

Vector = NDArray[np.float64]


def surfaces(material: Material) -> tuple[Vector, Vector, Vector]:
    """Normals [9, 3], flows [9, 3] and limits [9] [Pa] of the planes 12, 13, 21, 23, 31, 32, then of the cutoff."""
    phi, psi = np.radians(material.friction_deg), np.radians(material.dilation_deg)
    pairs = list(itertools.permutations(range(3), 2))
    normals, flows, limits = np.zeros((9, 3)), np.zeros((9, 3)), np.zeros(9)
    for row, (i, j) in enumerate(pairs):
        normals[row, [i, j]] = 1.0 + np.sin(phi), np.sin(phi) - 1.0
        flows[row, [i, j]] = 1.0 + np.sin(psi), np.sin(psi) - 1.0
    normals[6:] = flows[6:] = np.eye(3)
    limits[:6] = 2.0 * material.cohesion * np.cos(phi)
    limits[6:] = material.tension_limit
    return normals, flows, limits


def elasticity(material: Material) -> Vector:
    """D in principal axes [Pa], shape [3, 3]."""
    return material.lame * np.ones((3, 3)) + 2.0 * material.shear_modulus * np.eye(3)


def lcp_return(material: Material, trial: Vector) -> tuple[Vector, Vector]:
    """The solution [Pa] for principal stresses of any order, shape [E, 3], and how far apart the solutions of all
    sets of surfaces lie that pass [Pa], shape [E]; where none passes it is infinite."""
    normals, flows, limits = surfaces(material)
    stiff = elasticity(material)
    scale = np.abs(trial).max(axis=1) + limits.max()
    excess = trial @ normals.T - limits
    best, miss = np.zeros_like(trial), np.full(len(trial), np.inf)
    low, high = np.full(trial.shape, np.inf), np.full(trial.shape, -np.inf)
    for size in range(4):
        for active in map(list, itertools.combinations(range(9), size)):
            matrix = normals[active] @ stiff @ flows[active].T
            if size and np.linalg.cond(matrix) > 1e10:
                continue
            rates = np.linalg.solve(matrix, excess[:, active].T).T if size else np.zeros((len(trial), 0))
            state = trial - rates @ flows[active] @ stiff
            wrong = (state @ normals.T - limits).max(axis=1)
            if size:
                wrong = np.maximum(wrong, -material.shear_modulus * rates.min(axis=1))
            wrong = np.maximum(wrong, 0.0) / scale
            better = wrong < miss
            best[better], miss[better] = state[better], wrong[better]
            passes = (wrong < 1e-11)[:, None]
            low = np.minimum(low, np.where(passes, state, np.inf))
            high = np.maximum(high, np.where(passes, state, -np.inf))
    return best, np.where(np.isfinite(low[:, 0]), (high - low).max(axis=1), np.inf)
