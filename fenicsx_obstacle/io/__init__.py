"""Solutions in files: saved folders, HDF5 and XDMF for ParaView, elements on subdivided cells.

Enters: what writes and reads the fields of a solution. Stays out: what solves; scenes, which write their own file.
"""
