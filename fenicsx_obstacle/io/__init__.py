"""Solutions in files: saved folders, HDF5 and XDMF for ParaView, elements on subdivided cells.

Contents: writing and reading the fields of a solution. Not here: solving; scenes, which write their own file.
"""
