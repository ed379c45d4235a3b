// SPDX-License-Identifier: GPL-3.0-or-later
// The simulated ATmega328P. One thread: callbacks of simavr (pin changes, the 50 us tick) only change state and write the
// log; changes of the whole processor, such as a reset, are made between two instructions, in the main loop.
#ifndef PROCESSOR_H
#define PROCESSOR_H

#include "sim_avr.h"

extern avr_t *avr;

#endif
