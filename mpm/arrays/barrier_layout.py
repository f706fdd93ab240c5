"""Columns of the arrays that describe masses held behind gates (`mpm.physics.barriers`, `mpm.initial.release`)."""

from enum import auto

from mpm.arrays.layout import Column


class Gate(Column):
    """Columns of `gates`, integers, shape [gates, len(Gate)]: a range of nodes that is held, [low, high)."""

    HELD = auto()  # line of its mass in `held`
    AXIS = auto()  # across which nodes are held; len(Gate): they are damped
    LOW_X = auto()
    LOW_Y = auto()
    LOW_Z = auto()
    HIGH_X = auto()
    HIGH_Y = auto()
    HIGH_Z = auto()


class Held(Column):
    """Columns of `held`, integers, shape [held masses, len(Held)]."""

    FIRST = auto()  # its particles: [first, last) of the scene's
    LAST = auto()
    RELEASE = auto()  # the frame in which its gates open; 0: when it has settled
    CALM = auto()  # frames in a row in which it was settled
    OPENED = auto()  # the frame in which its gates opened; 0 while they are closed


class Holding(Column):
    """Columns of `holding`, real, shape [held masses, len(Holding)]."""

    RATE = auto()  # of damping [1/s]
    PARTICLE = auto()  # mass of a particle [kg, per metre of width in 2D]
    MOST_KINETIC = auto()  # of a settled mass [J, per metre of width in 2D]
    MOST_IMPULSE = auto()  # change of its momentum in a frame [N s]
    KINETIC = auto()  # in the frame that is recorded
    MOMENTUM_X = auto()
    MOMENTUM_Y = auto()
    MOMENTUM_Z = auto()
    EARLIER_X = auto()  # momentum in the frame before
    EARLIER_Y = auto()
    EARLIER_Z = auto()
