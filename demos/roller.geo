// A quarter of a round section of radius 40 that rests on the plane y = 0: right of the axis x = 0, below the centre
// (0, 40). Cells are small within 1.6 of the origin, where contact is, and grow in proportion to the distance beyond.
SetFactory("Built-in");
R = 40;
h = 0.1;
angle = 0.08;
Point(1) = {0, 0, 0};
Point(2) = {R*Sin(angle), R*(1 - Cos(angle)), 0};
Point(3) = {R, R, 0};
Point(4) = {0, R, 0};
Circle(1) = {1, 4, 2};
Circle(2) = {2, 4, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Physical Curve("contact") = {1};
Physical Curve("side") = {2};
Physical Curve("middle") = {3};
Physical Curve("axis") = {4};
Physical Surface("roller") = {1};
Field[1] = MathEval;
Field[1].F = Sprintf("%g*(1 + 1.5*max(sqrt(x*x + y*y) - 1.6, 0))", h);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
