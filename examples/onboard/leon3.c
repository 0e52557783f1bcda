/* SPDX-License-Identifier: MIT */
/* The flight loop on a LEON3 without an operating system: CAN_OC of GRLIB (an SJA1000 in PeliCAN mode). Trap table and
   interrupt controller are your board support's (BCC, RTEMS): it calls can_interrupt(), and its start-up takes the
   place of start below, which is the least with which a program links. */

#include "flight.h"

#include <stddef.h>
#include <string.h>

/* Registers of the CAN controller; the base address is your design's. */
#define CAN ((volatile uint8_t *)0xFFF20000u)
enum can_register { COMMAND = 1, STATUS = 2, INTERRUPT = 3, BUFFER = 16 };
#define COMMAND_TRANSMIT 0x01u
#define COMMAND_RELEASE 0x04u
#define STATUS_RECEIVED 0x01u
#define STATUS_TRANSMIT_FREE 0x04u
#define STATUS_BUS_OFF 0x80u
#define FRAME_EXTENDED 0x80u
#define FRAME_REMOTE 0x40u
#define ERROR_BUS_OFF 0x40u /* class of SocketCAN */

void can_interrupt(void);
void begin(void);

__asm__(".section .text.start, \"ax\"\n"
        ".global start\n"
        "start:\n"
        "        set stack_top - 96, %sp\n" /* room to save a window and arguments, as the ABI wants it */
        "        mov 0, %fp\n"
        "        call begin\n"
        "         nop\n"
        "halt:   ba halt\n"
        "         nop\n"
        ".text\n");

extern unsigned char zero_begin[];
extern unsigned char zero_end[];

void can_interrupt(void)
{
    zygos_frame_t frame;
    (void)CAN[INTERRUPT]; /* reading acknowledges */
    while ((CAN[STATUS] & STATUS_RECEIVED) != 0u) {
        const uint32_t head = CAN[BUFFER];
        memset(&frame, 0, sizeof frame);
        frame.flags = (uint8_t)((((head & FRAME_EXTENDED) != 0u) ? ZYGOS_FRAME_EXTENDED : 0) |
                                (((head & FRAME_REMOTE) != 0u) ? ZYGOS_FRAME_REMOTE : 0));
        frame.id = ((uint32_t)CAN[BUFFER + 1] << 3) | ((uint32_t)CAN[BUFFER + 2] >> 5); /* not read of extended ones */
        frame.length = (uint8_t)(head & 0x0Fu);
        for (uint32_t i = 0; i < sizeof frame.data; i++) {
            frame.data[i] = CAN[BUFFER + 3 + i];
        }
        CAN[COMMAND] = COMMAND_RELEASE;
        flight_receive(&frame);
    }
    if ((CAN[STATUS] & STATUS_BUS_OFF) != 0u) {
        memset(&frame, 0, sizeof frame);
        frame.id = ERROR_BUS_OFF;
        frame.flags = ZYGOS_FRAME_ERROR;
        flight_receive(&frame);
    }
}

void port_send(const zygos_frame_t *frame)
{
    if ((CAN[STATUS] & STATUS_TRANSMIT_FREE) == 0u) {
        return; /* one buffer: a flight program would queue, and send from the transmit interrupt */
    }
    CAN[BUFFER] = frame->length;
    CAN[BUFFER + 1] = (uint8_t)(frame->id >> 3);
    CAN[BUFFER + 2] = (uint8_t)(frame->id << 5);
    for (uint32_t i = 0; i < frame->length; i++) {
        CAN[BUFFER + 3 + i] = frame->data[i];
    }
    CAN[COMMAND] = COMMAND_TRANSMIT;
}

/* Your EEPROM or MRAM. */
uint32_t port_load(uint8_t head[ZYGOS_SNAPSHOT_HEAD], void *image, uint32_t size)
{
    (void)head;
    (void)image;
    (void)size;
    return 0;
}

uint32_t port_save(const uint8_t head[ZYGOS_SNAPSHOT_HEAD], const void *image, uint32_t size)
{
    (void)head;
    (void)image;
    (void)size;
    return 0;
}

void begin(void)
{
    memset(zero_begin, 0, (size_t)(zero_end - zero_begin));
    if (flight_start() < 0) {
        return;
    }
    for (;;) {
        flight_task();
        (void)flight_solve(); /* frames wait meanwhile */
    }
}
