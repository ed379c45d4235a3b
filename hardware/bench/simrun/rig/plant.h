// SPDX-License-Identifier: GPL-3.0-or-later
// The devices on the pins: table, home switch, lasers with their contactor, e-stop, camera ready.
#ifndef PLANT_H
#define PLANT_H

#include <stdbool.h>
#include <stdint.h>

enum laser_health { LASER_GOOD, LASER_WELDED, LASER_DEAD };
enum { LASERS = 2 };
struct laser {
    bool gate;   // as the pin drives it
    bool light;  // whether it shines
    enum laser_health health;
};
struct plant {
    long position;             // microsteps; the home switch's lower edge, as seen from above, is at 0
    long microsteps_per_turn;
    long home_width;           // the switch is closed at positions (-home_width, 0] of every turn
    unsigned bounce_us;        // how long it chatters at each change
    int home_forced;           // -1: as the plant is; else the level of the pin
    long drop;                 // steps still to lose
    bool stalled;              // the rotor does not follow at all
    double torque_limit;       // steps/s above which steps are lost; 0: none
    struct laser laser[LASERS];
    bool estop;                // pressed, or its wire broken
    int ready;                 // level at the camera-ready input
    bool step, dir, enabled, contactor, trigger, led;
    uint64_t steps, lost_steps;
};
extern struct plant plant;
void plant_connect(void);
void plant_after_reset(void);
void plant_tick(void);
void plant_update(void);
void plant_set_pin(char port, int bit, int value);

#endif
