// A mount that holds a camera by its lens and a line laser beside it. Millimetres, degrees.
//
//   x from the camera to the laser, y forwards, z up; the camera's lens looks along y, above the origin.
//
// part = "whole": one beam with both clamps, for baselines that fit the printer.
// part = "camera" or "laser": one clamp with a socket for a square tube, for longer baselines. The tube, not the
// plastic, then keeps the distance.
//
// Printed flat on its underside, without supports. A stiff filament; no PLA where it gets warm.
//
// SPDX-License-Identifier: Apache-2.0

part = "whole";
baseline = 150;      // lens axis to laser axis, at y = 0
laser_angle = 5;     // of the laser towards the camera's axis: `jaxscan design` says it
lens_barrel = 30;    // outer diameter of the lens where it is clamped: not on a ring that turns
laser_barrel = 12;   // outer diameter of the laser module
axis_height = 32;    // of both axes above the underside
tube = 20;           // outer side of the square tube
play = 0.3;          // between a part and its seat, on the diameter
wall = 5;
depth = 24;          // length of the clamps, along y
base = 10;           // thickness of the beam
screw = 4.3;         // clearance for M4
$fn = 64;

ear = 11;            // height of the two ears of a clamp
slit = 2.5;
overhang = 8;        // of the beam beyond each clamp

function outer(barrel) = barrel + 2 * wall;
function footprint(barrel) = outer(barrel) + depth;
function height(barrel) = axis_height + outer(barrel) / 2 + ear;
left = footprint(lens_barrel) / 2 + overhang;
right = footprint(laser_barrel) / 2 + overhang;
width = depth + 2 * overhang;
block = tube + 2 * wall;

// What a test measures on the finished part.
size = part == "whole" ? [left + baseline + right, width, height(lens_barrel)]
     : [block_length(), width, block + height(part == "camera" ? lens_barrel : laser_barrel)];
echo(size = size);

assert(part == "whole" || part == "camera" || part == "laser", "part: whole, camera or laser");
assert(baseline > left + right - 2 * overhang, "baseline: the clamps would touch; make it longer");
assert(abs(laser_angle) <= 45, "laser_angle: expected at most 45 degrees to either side");
assert(axis_height >= base + outer(lens_barrel) / 2 - wall, "axis_height: the lens would touch the beam; raise it");
assert(axis_height >= base + outer(laser_barrel) / 2 - wall, "axis_height: the laser would touch the beam; raise it");

function block_length() = 2 * (part == "camera" ? left : right);

// A ring on a foot, split on top, drawn together by one M4 screw across the ears. Its axis is y.
module clamp(barrel) {
    difference() {
        union() {
            translate([0, depth / 2, axis_height]) rotate([90, 0, 0]) cylinder(d = outer(barrel), h = depth);
            translate([-outer(barrel) / 2, -depth / 2, base / 2])
                cube([outer(barrel), depth, axis_height - base / 2]);
            translate([-(slit / 2 + wall), -depth / 2, axis_height])
                cube([slit + 2 * wall, depth, outer(barrel) / 2 + ear]);
        }
        translate([0, depth / 2 + 1, axis_height]) rotate([90, 0, 0]) cylinder(d = barrel + play, h = depth + 2);
        translate([-slit / 2, -depth / 2 - 1, axis_height]) cube([slit, depth + 2, outer(barrel) + ear]);
        translate([-outer(barrel), 0, axis_height + outer(barrel) / 2 + ear / 2])
            rotate([0, 90, 0]) cylinder(d = screw, h = 2 * outer(barrel));
    }
}

module beam(from, to) {
    translate([from, -width / 2, 0]) cube([to - from, width, base]);
}

// Two holes to screw the beam to the table's plate.
module holes(x) {
    for (side = [-1, 1])
        translate([x, side * (width / 2 - overhang / 2 - screw / 2), -1]) cylinder(d = screw, h = base + 2);
}

module socket(length) {
    difference() {
        translate([-length / 2, -width / 2, 0]) cube([length, width, block + base]);
        translate([-length / 2 - 1, -(tube + play) / 2, wall]) cube([length + 2, tube + play, tube + play]);
        // A screw from below each end presses on the tube.
        for (side = [-1, 1])
            translate([side * (length / 2 - overhang), 0, -1]) cylinder(d = screw, h = wall + 2);
    }
}

if (part == "whole") {
    difference() {
        beam(-left, baseline + right);
        holes(baseline * 0.3);
        holes(baseline * 0.7);
    }
    clamp(lens_barrel);
    translate([baseline, 0, 0]) rotate([0, 0, laser_angle]) clamp(laser_barrel);
} else {
    socket(block_length());
    translate([0, 0, block])
        if (part == "camera") clamp(lens_barrel);
        else rotate([0, 0, laser_angle]) clamp(laser_barrel);
}
