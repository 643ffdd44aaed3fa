// |x| + |y| < 1, in triangles with right angles.
N = 16;
Point(1) = {-1, 0, 0};
Point(2) = {0, -1, 0};
Point(3) = {1, 0, 0};
Point(4) = {0, 1, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Transfinite Curve {1, 2, 3, 4} = N + 1;
Transfinite Surface {1};
Physical Curve("around") = {1, 2, 3, 4};
Physical Surface("membrane") = {1};
