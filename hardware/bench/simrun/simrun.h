// SPDX-License-Identifier: GPL-3.0-or-later
// simrun: the scanner's firmware in a simulated ATmega328P, with the rig around it.
//
// One thread. simavr's callbacks (pin changes, the 50 us tick) only change state and write the log; whatever touches the
// processor as a whole - a reset above all - is done between two instructions, in the main loop.
#ifndef SIMRUN_H
#define SIMRUN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "sim_avr.h"

extern avr_t *avr;

// ------------------------------------------------------------------------------------------------ clock.c
// Cycles since the start of the log. simavr may begin at 0 again with each reset; this never does.
uint64_t clock_cycles(void);
void clock_begin_at(uint64_t cycles);
void clock_notice_reset(void);
// Waits until the wall clock has caught up with the simulated one; `speed` 0 never waits.
void pace(double speed, double frequency, int wake_fd);

// ------------------------------------------------------------------------------------------------ edges.c
bool edges_open(const char *path);
void edge(const char *pin, int value);
void note(const char *key, const char *value);
void edges_flush(void);

// ------------------------------------------------------------------------------------------------ noise.c
enum direction { RX, TX };  // seen from the controller
struct noise {
    double corrupt, drop, duplicate;
};
extern struct noise noise[2];
void noise_seed(uint64_t seed);
double noise_uniform(void);
// Puts what arrives of a byte into out[2] and returns how many bytes that is: 0, 1 or 2.
int noise_apply(enum direction direction, uint8_t byte, uint8_t out[2]);

// ------------------------------------------------------------------------------------------------ plant.c
enum laser_health { LASER_GOOD, LASER_WELDED, LASER_DEAD };
struct plant {
    long position;             // microsteps; the home switch's lower edge, as seen from above, is at 0
    long microsteps_per_turn;
    long home_width;           // the switch is closed at positions (-home_width, 0] of every turn
    unsigned bounce_us;        // how long it chatters at each change
    int home_forced;           // -1: as the plant is; else what the pin reads
    long drop;                 // steps still to lose
    bool stalled;              // the rotor does not follow at all
    double torque_limit;       // steps/s above which steps are lost; 0: none
    enum laser_health laser_health;
    bool estop;                // pressed, or its wire broken
    int ready;                 // level at the camera-ready input
    bool step, dir, enabled, laser, contactor, trigger, led, light;
    uint64_t steps, lost_steps;
};
extern struct plant plant;
void plant_connect(void);
void plant_after_reset(void);
void plant_tick(void);
void plant_update(void);
void plant_set_pin(char port, int bit, int value);

// ------------------------------------------------------------------------------------------------ line.c
struct line_counts {
    uint64_t received, sent, overrun, unheard;
};
extern struct line_counts line_counts;
bool line_plug(const char *link);
void line_unplug(void);
bool line_plugged(void);
bool line_host_present(void);
void line_connect(void);
void line_after_reset(void);
void line_tick(void);
int line_wake_fd(void);

// ------------------------------------------------------------------------------------------------ control.c
bool control_listen(const char *path);
void control_poll(void);
void control_close(void);

// ------------------------------------------------------------------------------------------------ main.c
extern double speed;
extern bool autoreset;
extern uint64_t resets;
void want_reset(const char *why);
void want_stop(void);

#endif
