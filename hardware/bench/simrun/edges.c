// SPDX-License-Identifier: GPL-3.0-or-later
// The log: one JSON object per line, stamped with cycle and plant position.
#include "edges.h"

#include <inttypes.h>
#include <stdio.h>

#include "clock.h"

static FILE *file;
static const long *table;
static bool waiting;

bool edges_open(const char *path, const long *position) {
    table = position;
    file = fopen(path, "a");
    return file != NULL;
}

void edge(const char *pin, int value) {
    if (!file) return;
    fprintf(file, "{\"cycle\":%" PRIu64 ",\"pin\":\"%s\",\"v\":%d,\"pos\":%ld}\n", clock_cycles(), pin, value,
            *table);
    waiting = true;
}

void note(const char *key, const char *value) {
    if (!file) return;
    fprintf(file, "{\"cycle\":%" PRIu64 ",\"%s\":\"%s\",\"pos\":%ld}\n", clock_cycles(), key, value, *table);
    waiting = true;
}

// Once per quantum of the main loop: whoever follows the log is at most that much behind.
void edges_flush(void) {
    if (waiting) fflush(file);
    waiting = false;
}
