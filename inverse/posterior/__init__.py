"""What the observation says of the parameters, over the whole box: an emulator of the MPM, its posterior, its answers.

Vectors of parameters are here in fractions of their ranges between the prior bounds: v in [0, 1]^U.
"""
