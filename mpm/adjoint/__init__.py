"""The solver's own adjoint: the exact derivative of a run with respect to all of its initial numbers.

The adjoint of a quantity x is dJ/dx, named `adj_x` (Griewank & Walther, Evaluating derivatives, 2008).

    pullback                    values local to a particle (stress, plastic return, cracks, gaps, softening, tractions,
                                the foot on a face) are traced from the functions of `mpm.physics` themselves
    stress, contact, faces      of a block of particles: the turn into principal axes; the contact with solids
    transfer, particles         both transfers by hand, with the motion of the weights
    grid, boundary              gravity, damping, AFLIP's change of velocity; barriers; walls with Coulomb friction
    kernel, tape, gradient      replay and reverse of a segment; checkpoints within a budget of memory; the user's calls

Scenes and threads work as in the solver: several scenes side by side, or one large scene on all threads. Unlike in the
solver, the particles of a very large scene are not sorted, so that sums differ in their last bits.

Taichi's own reverse mode (1.7.4) is as accurate for quantities local to a particle, but it differentiates a whole
kernel, which only Python can launch: it cannot run in the loop of a thread that reverses all steps of a scene. A launch
for every step and piece costs as much as a step, and vectors of lanes and local lists would have to become arrays.

There is no tangent mode: a Jacobian of M numbers takes one replay with M reverses, and for few unknowns differences
cost less than either (docs/efficiency.md).
"""
