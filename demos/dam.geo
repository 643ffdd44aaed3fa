// A dam with vertical walls, 16 m by 24 m: fine where the water seeps out, about 15000 nodes.
SetFactory("Built-in");
width = 16;
height = 24;
Point(1) = {0, 0, 0, 0.5};
Point(2) = {width, 0, 0, 0.06};
Point(3) = {width, height, 0, 0.06};
Point(4) = {0, height, 0, 0.5};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4};
Plane Surface(1) = {1};
Physical Curve("ground") = {1};
Physical Curve("downstream") = {2};
Physical Curve("top") = {3};
Physical Curve("upstream") = {4};
Physical Surface("soil") = {1};
