"""The shipped GNS weights against the MPM, on scenes that are in no training set."""
