/* SPDX-License-Identifier: MIT */
/* What interrupt and task did, call by call: which frames zygos_frame() stored, and how many of them each zygos_step()
   took. That depends on how fast they were, and a host cannot know it. */

#include "zygos/zygos.h"

#define MOST 65535u

struct {
    uint32_t frames;
    uint32_t steps;
    uint16_t taken[MOST + 1u];
    uint8_t stored[MOST + 1u];
} calls;

int __real_zygos_frame(zygos_t *self, const zygos_frame_t *frame);
int __wrap_zygos_frame(zygos_t *self, const zygos_frame_t *frame);
int __real_zygos_step(zygos_t *self);
int __wrap_zygos_step(zygos_t *self);

int __wrap_zygos_frame(zygos_t *self, const zygos_frame_t *frame)
{
    const int verdict = __real_zygos_frame(self, frame);
    calls.stored[calls.frames & MOST] = (verdict == 1) ? 1u : 0u;
    calls.frames++;
    return verdict;
}

int __wrap_zygos_step(zygos_t *self)
{
    const uint32_t before = self->tail;
    const int stepped = __real_zygos_step(self);
    calls.taken[calls.steps & MOST] = (uint16_t)(self->tail - before);
    calls.steps++;
    return stepped;
}
