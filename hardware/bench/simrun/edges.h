// SPDX-License-Identifier: GPL-3.0-or-later
// The log of the pins.
#ifndef EDGES_H
#define EDGES_H

#include <stdbool.h>

bool edges_open(const char *path, const long *position);  // position: of the table, said in every line
void edge(const char *pin, int value);
void note(const char *key, const char *value);
void edges_flush(void);

#endif
