"""SCENES FOR OTHER PROGRAMS: meshes, and what they need to trace the same light; and their answers beside ours."""
