/* SPDX-License-Identifier: MIT */
/* Frames from a file, each handed over in a timer interrupt that comes at odd times, many in each cycle's work: what
   a receive interrupt may do to the task at the worst.

   storm.bin: three uint32 (frames, shortest and longest time between two interrupts, in ticks of SysTick), then
   zygos_frame_t. storm.out: zygos_arm_t, and a uint32: frames that came while a cycle was worked off. */

#include "arm_config.h"
#include "core.h"
#include "semihosting.h"

#define TIMER_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define TIMER_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define TIMER_VALUE (*(volatile uint32_t *)0xE000E018u)
#define TIMER_ON 7u /* counts the processor's clock, interrupts */

#define MAX_FRAMES 16384u

static zygos_arm_t arm;
static zygos_frame_t frames[MAX_FRAMES];
static uint32_t head[3];
static volatile uint32_t next;
static volatile uint32_t working;
static uint32_t interrupted;
static uint32_t noise = 1;

void tick_interrupt(void)
{
    noise = noise * 1664525u + 1013904223u;
    TIMER_RELOAD = head[1] + (noise >> 16) % (head[2] - head[1]);
    if (next < head[0]) {
        interrupted += working;
        zygos_arm_frame(&arm, &frames[next]);
        next = next + 1u;
    }
}

int main(void)
{
    const int32_t in = semihosting_open("storm.bin", SEMIHOSTING_READ);
    const uint32_t size = (uint32_t)sizeof(zygos_frame_t);
    if ((semihosting_read(in, head, sizeof head) != sizeof head) || (head[0] > MAX_FRAMES) ||
        (semihosting_read(in, frames, head[0] * size) != head[0] * size) || (zygos_arm_init(&arm, &arm_config) != 1)) {
        return 1;
    }
    TIMER_RELOAD = head[1];
    TIMER_VALUE = 0;
    TIMER_CONTROL = TIMER_ON;
    while ((next < head[0]) || (arm.receiver.queue.head != arm.receiver.queue.tail)) {
        working = (arm.receiver.queue.head != arm.receiver.queue.tail) ? 1u : 0u;
        if (zygos_arm_step(&arm) == ZYGOS_E_STATE) {
            break; // a changed place: no cycle is processed any more, and the queue would not become empty
        }
        working = 0;
    }
    const int32_t out = semihosting_open("storm.out", SEMIHOSTING_WRITE);
    semihosting_write(out, &arm, sizeof arm);
    semihosting_write(out, &interrupted, sizeof interrupted);
    return (semihosting_close(out) == 0) ? 0 : 2;
}
