// A parallelogram cut along its longer diagonals.
N = 16;
Point(1) = {-4, -2, 0};
Point(2) = {0, -2, 0};
Point(3) = {4, 2, 0};
Point(4) = {0, 2, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1, 2, 3, 4} = N + 1;
Transfinite Surface {1} Left;
Physical Curve("around") = {1, 2, 3, 4};
Physical Surface("membrane") = {1};
