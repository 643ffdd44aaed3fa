// A block of 40 by 40 on which a rigid indenter presses at the origin: a half section to the right of the axis x = 0.
// Cells are small within 1.6 of the origin, where contact is, and grow in proportion to the distance beyond.
SetFactory("Built-in");
side = 40;
h = 0.1;
Point(1) = {0, 0, 0};
Point(2) = {3, 0, 0};
Point(3) = {side, 0, 0};
Point(4) = {side, -side, 0};
Point(5) = {0, -side, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 1};
Curve Loop(1) = {1, 2, 3, 4, 5};
Plane Surface(1) = {1};
Physical Curve("contact") = {1};
Physical Curve("top") = {2};
Physical Curve("side") = {3};
Physical Curve("bottom") = {4};
Physical Curve("axis") = {5};
Physical Surface("block") = {1};
Field[1] = MathEval;
Field[1].F = Sprintf("%g*(1 + 1.5*max(sqrt(x*x + y*y) - 1.6, 0))", h);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
