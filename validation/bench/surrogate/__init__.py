"""The learned simulator on scenes that it never saw: what it gets wrong, and when it is worth its seconds."""
