"""A scene on a mesh: levels, nodal data and the discrete problem."""
