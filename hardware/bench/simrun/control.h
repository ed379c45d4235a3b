// SPDX-License-Identifier: GPL-3.0-or-later
// The control socket.
#ifndef CONTROL_H
#define CONTROL_H

#include <stdbool.h>

bool control_listen(const char *path);
void control_poll(void);
void control_close(void);

#endif
