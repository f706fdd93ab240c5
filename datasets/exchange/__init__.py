"""External file formats: of other simulators, VTK, rasters and meshes; untrusted files are never executed."""
