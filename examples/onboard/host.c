/* SPDX-License-Identifier: MIT */
/* The flight loop on a workstation: frames come from a log of candump, what is sent goes to standard output as one.

   host LOG [STATE]    STATE: file of the stored state; read where it is there, written at the end */

#include "flight.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_LINE 256
#define ERROR_BIT 0x20000000uL
#define BASE_DIGITS 3 /* of an 11-bit identifier; others have eight */

static const char *state;

static _Noreturn void end(const char *told, const char *what)
{
    fprintf(stderr, "%s: %s\n", what, told);
    exit(2);
}

void port_send(const zygos_frame_t *frame)
{
    printf("(0.000000) can0 %03X#", (unsigned)frame->id);
    for (uint32_t i = 0; i < frame->length; i++) {
        printf("%02X", (unsigned)frame->data[i]);
    }
    printf("\n");
}

uint32_t port_load(uint8_t head[ZYGOS_SNAPSHOT_HEAD], void *image, uint32_t size)
{
    FILE *file = (state != NULL) ? fopen(state, "rb") : NULL;
    if (file == NULL) {
        return 0;
    }
    size_t moved = fread(head, 1, ZYGOS_SNAPSHOT_HEAD, file);
    moved += fread(image, 1, size, file);
    moved += (fgetc(file) != EOF) ? 1u : 0u; /* a longer file is no state of ours */
    (void)fclose(file);
    return (uint32_t)moved;
}

uint32_t port_save(const uint8_t head[ZYGOS_SNAPSHOT_HEAD], const void *image, uint32_t size)
{
    FILE *file = fopen(state, "wb");
    if (file == NULL) {
        return 0;
    }
    size_t moved = fwrite(head, 1, ZYGOS_SNAPSHOT_HEAD, file);
    moved += fwrite(image, 1, size, file);
    return (fclose(file) == 0) ? (uint32_t)moved : 0u;
}

/* A line as "(0.050150) vcan0 181#0123456789ABCDEF". Returns 1, or 0 when it is none. */
static int read_frame(const char *line, zygos_frame_t *frame)
{
    int identifier = 0;
    int data = 0;
    unsigned long id = 0;
    memset(frame, 0, sizeof *frame);
    if ((sscanf(line, "(%*[0-9.]) %*s %n%lx%n", &identifier, &id, &data) != 1) || (line[data] != '#')) {
        return 0;
    }
    frame->id = (uint32_t)(id & ~ERROR_BIT);
    if (data - identifier > BASE_DIGITS) {
        frame->flags = ((id & ERROR_BIT) != 0) ? ZYGOS_FRAME_ERROR : ZYGOS_FRAME_EXTENDED;
    }
    const char *at = line + data + 1;
    if ((*at == '#') || (*at == 'R')) {
        frame->flags |= (*at == '#') ? ZYGOS_FRAME_FD : ZYGOS_FRAME_REMOTE;
        return 1;
    }
    unsigned byte = 0;
    while ((frame->length < sizeof frame->data) && isxdigit((unsigned char)at[0]) && isxdigit((unsigned char)at[1])) {
        (void)sscanf(at, "%2x", &byte);
        frame->data[frame->length++] = (uint8_t)byte;
        at += 2;
    }
    return (*at == '\n') || (*at == '\r') || (*at == '\0') || (*at == ' ');
}

static void print_estimate(const zygos_estimate_t *estimate)
{
    const flight_learned_t *learned = flight_learned();
    printf("cycle %lu: validity %u, reason %u, learned in cycle %lu\n", (unsigned long)estimate->cycle,
           (unsigned)estimate->validity, (unsigned)estimate->reason, (unsigned long)learned->cycle);
    for (uint32_t i = 0; i < estimate->parameters; i++) {
        if (learned->known[i] == 1u) {
            printf("  %2u  %.17g +- %.17g\n", (unsigned)i, learned->value[i], learned->half95[i]);
        }
    }
}

int main(int count, char **words)
{
    if ((count < 2) || (count > 3)) {
        end("host LOG [STATE]", "usage");
    }
    FILE *log = fopen(words[1], "r");
    if (log == NULL) {
        end("cannot be read; remedy: name a log that candump -l wrote", words[1]);
    }
    state = (count == 3) ? words[2] : NULL;
    const int started = flight_start();
    if (started < 0) {
        end("the library refuses arm_config.h", "start");
    }
    printf("%s\n", (started == 2) ? "resumed" : "started");
    char line[LONGEST_LINE];
    zygos_frame_t frame;
    while (fgets(line, sizeof line, log) != NULL) {
        if (read_frame(line, &frame) == 0) {
            end("no line of candump's; remedy: record with candump -l", line);
        }
        flight_receive(&frame);                            /* here the interrupt, */
        flight_task();                                     /* the task of each period */
        const zygos_estimate_t *estimate = flight_solve(); /* and the background are called in turn */
        if (estimate != NULL) {
            print_estimate(estimate);
        }
    }
    (void)fclose(log);
    if ((state != NULL) && (flight_store() != 1)) {
        end("the state cannot be written", state);
    }
    return 0;
}
