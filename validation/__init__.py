"""Whether to believe it: the loop in which the MPM confirms or corrects, certainty, comparisons, reports."""
