"""UFL only: kinematics, materials and the weak forms of the report, one formula per function.

Nothing here knows mesh data, MPI or PETSc; :mod:`vmdg` binds these expressions to a mesh.
"""
