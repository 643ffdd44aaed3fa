// The cross-section of a rolled bar: an I of 60 mm by 80 mm, flanges of 12 mm, a web of 8 mm, in cells of 1 mm. The grid
// has edges along the middle of web and flanges, where sand heaped on the section has its ridges.
SetFactory("Built-in");
mm = 1e-3;
W = 30*mm;                          // half the width
H = 40*mm;                          // half the height
F = 28*mm;                          // where the flanges begin
S = 4*mm;                           // half the thickness of the web
x[] = {-W, -S, S, W};
y[] = {-H, -F, F, H};
For j In {0:3}
  For i In {0:3}
    Point(1 + i + 4*j) = {x[i], y[j], 0};
  EndFor
EndFor
For j In {0:3}                      // along x, then along y
  For i In {0:2}
    Line(1 + i + 3*j) = {1 + i + 4*j, 2 + i + 4*j};
    Transfinite Curve {1 + i + 3*j} = 1 + Round((x[i + 1] - x[i])/mm);
  EndFor
EndFor
For j In {0:2}
  For i In {0:3}
    If (j != 1 || i == 1 || i == 2)
      Line(21 + i + 4*j) = {1 + i + 4*j, 5 + i + 4*j};
      Transfinite Curve {21 + i + 4*j} = 1 + Round((y[j + 1] - y[j])/mm);
    EndIf
  EndFor
EndFor
For j In {0:2}
  For i In {0:2}
    If (j != 1 || i == 1)
      Curve Loop(1 + i + 3*j) = {1 + i + 3*j, 22 + i + 4*j, -(4 + i + 3*j), -(21 + i + 4*j)};
      Plane Surface(1 + i + 3*j) = {1 + i + 3*j};
      Transfinite Surface {1 + i + 3*j} AlternateRight;
    EndIf
  EndFor
EndFor
Physical Surface("steel") = {1, 2, 3, 5, 7, 8, 9};
