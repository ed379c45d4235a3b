// SPDX-License-Identifier: GPL-3.0-or-later
#include "orders.h"

#include <stddef.h>

struct orders orders = {.speed = 1};
uint64_t resets;
