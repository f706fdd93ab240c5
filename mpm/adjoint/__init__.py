"""The solver's own adjoint: the exact derivative of a run with respect to everything that it begins with.

The adjoint of a quantity x is dJ/dx, in names `adj_x` (Griewank & Walther, Evaluating derivatives, 2008).

    pullback                    what is local to a particle (stress, plastic return, cracks, gaps, softening, tractions,
                                the foot on a face) is traced from the functions of `mpm.physics` themselves
    stress, contact, faces      of a block of particles: the turn into principal axes; what a step keeps of solids
    transfer, particles         both transfers by hand, with the motion of the weights
    grid, boundary              gravity, damping, AFLIP's change of velocity; barriers; walls with Coulomb friction
    kernel, tape, gradient      replay and reverse of a segment; checkpoints within a budget of memory; the user's calls

Scenes and threads are the solver's: several scenes side by side, or one large scene on all threads. The particles of a
very large scene are not sorted as the solver does, so that sums differ in their last bits.

Taichi's own reverse mode (1.7.4) is as accurate for what is local to a particle, but it differentiates a whole kernel,
and only Python can launch that: not the loop of a thread, in which all steps of a scene are reversed. A launch for
every step and piece costs as much as a step, and vectors of lanes and local lists would have to become arrays.

There is no tangent: a Jacobian of M numbers is one replay with M reverses, and for few unknowns differences
cost less than either (docs/efficiency.md).
"""
