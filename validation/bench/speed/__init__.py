"""Seconds and memory: of the MPM, of the GNS beside a textbook's network, and what training choices change."""
