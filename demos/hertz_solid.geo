// A block of 40 by 40 by 40 on which a rigid sphere presses at the origin: a quarter of it, beside x = 0 and y = 0.
// Cells are small within 1.5 of the origin, where contact is, and grow in proportion to the distance beyond.
SetFactory("OpenCASCADE");
side = 40;
h = 0.25;
Box(1) = {0, 0, -side, side, side, side};
Rectangle(20) = {0, 0, 0, 3, 3};
BooleanFragments{ Volume{1}; Delete; }{ Surface{20}; Delete; }
e = 1e-3;
// parts of the boundary, by their boxes
c() = Surface In BoundingBox {-e, -e, -e, 3+e, 3+e, e};
l() = Surface In BoundingBox {-e, -e, -side-e, e, side+e, e};
f() = Surface In BoundingBox {-e, -e, -side-e, side+e, e, e};
b() = Surface In BoundingBox {-e, -e, -side-e, side+e, side+e, -side+e};
Physical Surface("contact") = {c()};
Physical Surface("left") = {l()};
Physical Surface("front") = {f()};
Physical Surface("bottom") = {b()};
Physical Volume("block") = {1};
Field[1] = MathEval;
Field[1].F = Sprintf("%g*(1 + 1.5*max(sqrt(x*x + y*y + z*z) - 1.5, 0))", h);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
