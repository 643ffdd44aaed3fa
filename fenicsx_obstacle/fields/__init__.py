"""The fields of a solution on its mesh: values at points, arrays at owned nodes, the same on P1 simplices.

Contents: scalar and vector-valued fields, the table of contact nodes, cells cut into simplices. Not here: how they are
computed; the values of the record; files and pictures, which take these fields.
"""
