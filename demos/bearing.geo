// The film of a journal bearing: the surface of a cylinder of radius 1 and length 2, about 1200 nodes.
// Both ends of the range of theta are the same nodes: the film is periodic without constraints.
SetFactory("Built-in");
size = 0.12;
Point(1) = {0, 0, -1};              // centre of the arcs
Point(2) = {1, 0, -1, size};        // theta = 0
Point(3) = {0, 1, -1, size};
Point(4) = {-1, 0, -1, size};
Point(5) = {0, -1, -1, size};
Circle(1) = {2, 1, 3};
Circle(2) = {3, 1, 4};
Circle(3) = {4, 1, 5};
Circle(4) = {5, 1, 2};
Point(11) = {0, 0, 1};
Point(12) = {1, 0, 1, size};
Point(13) = {0, 1, 1, size};
Point(14) = {-1, 0, 1, size};
Point(15) = {0, -1, 1, size};
Circle(11) = {12, 11, 13};
Circle(12) = {13, 11, 14};
Circle(13) = {14, 11, 15};
Circle(14) = {15, 11, 12};
Line(21) = {2, 12};                 // along the axis
Line(22) = {3, 13};
Line(23) = {4, 14};
Line(24) = {5, 15};
Curve Loop(1) = {1, 22, -11, -21};
Curve Loop(2) = {2, 23, -12, -22};
Curve Loop(3) = {3, 24, -13, -23};
Curve Loop(4) = {4, 21, -14, -24};
Surface(1) = {1};
Surface(2) = {2};
Surface(3) = {3};
Surface(4) = {4};
Physical Curve("ends") = {1, 2, 3, 4, 11, 12, 13, 14};
Physical Curve("groove") = {21};
Physical Surface("film") = {1, 2, 3, 4};
