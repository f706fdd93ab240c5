"""The loop: the surrogate proposes, the MPM checks and corrects it, and gives the verdict."""
