"""The compiled inner loops on a CPU; what they compute is defined in `gns.model`."""
