/* SPDX-License-Identifier: MIT */
/* A plugin of QEMU (TCG plugin API, version 1) that counts instructions by function and by stage.

   Arguments: symbols=FILE, out=FILE. A line of the first is a function: its address in hex, its bytes, and three
   numbers that say

       room    what its instructions are booked on: a stage, or one of enum room
       phase   the stage that begins where it is entered, or -1
       mark    1: entering it ends a part

   and the first line has the number of stages and those of the rooms `cycle` and `wire`. Each part is written as
   int64: the stages, then the own instructions of every function in the order of the symbols.

   QEMU runs code in straight pieces without a branch but at their end, so it suffices to count a piece when it begins.
   Debian has no qemu-plugin.h; what is needed of it is declared here. */

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
typedef void (*translated_t)(qemu_plugin_id_t id, struct qemu_plugin_tb *piece);
typedef void (*executed_t)(unsigned int processor, void *data);
typedef void (*ended_t)(qemu_plugin_id_t id, void *data);
enum { QEMU_PLUGIN_CB_NO_REGS = 0 };
void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id, translated_t call);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *piece, executed_t call, int flags, void *data);
void qemu_plugin_register_atexit_cb(qemu_plugin_id_t id, ended_t call, void *data);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *piece);
uint64_t qemu_plugin_tb_vaddr(const struct qemu_plugin_tb *piece);
int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int count, char **argument);
extern int qemu_plugin_version;
int qemu_plugin_version = 1;

enum room {
    ROOM_TOP = -1,     /* zygos.c and arm.c: what they call is booked on the callee's room until that returns */
    ROOM_RUNTIME = -2, /* of the compiler's: booked on whoever called it */
    ROOM_OUTSIDE = -3  /* not counted */
};

#define MOST 2000

static struct {
    uint64_t address, size;
    int room, phase, mark;
} function[MOST];
static int64_t part[MOST]; /* stages, then functions */
static int functions, stages, cycle, wire;
static int room = ROOM_TOP;
static int phase = -1;
static FILE *out;

static void end_part(void)
{
    fwrite(part, sizeof part[0], (size_t)(stages + functions), out);
    memset(part, 0, sizeof part);
}

/* data: instructions, and above them the function and whether it is entered. */
static void execute(unsigned int processor, void *data)
{
    (void)processor;
    const uintptr_t word = (uintptr_t)data;
    const int64_t count = (int64_t)(word & 0xFFFFu);
    const int at = (int)((word >> 17) & 0xFFFFu);
    const bool entered = ((word >> 16) & 1u) != 0;
    const int own = function[at].room;
    if (entered && function[at].mark) {
        end_part();
    }
    if (own == ROOM_OUTSIDE) {
        phase = -1;
        room = ROOM_TOP;
        return;
    }
    if (entered && (function[at].phase >= 0)) {
        phase = function[at].phase;
    }
    if (phase < 0) {
        return;
    }
    const bool passes = (own >= 0) && ((room == ROOM_TOP) || (room == cycle) || (room == wire));
    if (own == ROOM_TOP) {
        room = ROOM_TOP;
    } else if (passes && ((room == ROOM_TOP) || (own == cycle) || (own == wire))) {
        room = own;
    }
    part[phase] += count;
    part[stages + at] += count;
    if (room >= 0) {
        part[room] += count;
    }
}

static void translate(qemu_plugin_id_t id, struct qemu_plugin_tb *piece)
{
    (void)id;
    const uint64_t address = qemu_plugin_tb_vaddr(piece);
    for (int at = 0; at < functions; at++) {
        if ((address >= function[at].address) && (address < function[at].address + function[at].size)) {
            const uintptr_t word = ((uintptr_t)at << 17) |
                                   ((address == function[at].address) ? (uintptr_t)1 << 16 : (uintptr_t)0) |
                                   (uintptr_t)qemu_plugin_tb_n_insns(piece);
            qemu_plugin_register_vcpu_tb_exec_cb(piece, execute, QEMU_PLUGIN_CB_NO_REGS, (void *)word);
            return;
        }
    }
    fprintf(stderr, "no function at %" PRIx64 "\n", address);
    exit(1);
}

static void end(qemu_plugin_id_t id, void *data)
{
    (void)id;
    (void)data;
    end_part();
    fclose(out);
}

int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int count, char **argument)
{
    (void)info;
    FILE *symbols = NULL;
    for (int k = 0; k < count; k++) {
        if (strncmp(argument[k], "symbols=", 8) == 0) {
            symbols = fopen(argument[k] + 8, "r");
        } else if (strncmp(argument[k], "out=", 4) == 0) {
            out = fopen(argument[k] + 4, "wb");
        }
    }
    if ((symbols == NULL) || (out == NULL) || (fscanf(symbols, "%d %d %d", &stages, &cycle, &wire) != 3)) {
        return 1;
    }
    while (stages + functions < MOST) {
        const int found =
            fscanf(symbols, "%" SCNx64 " %" SCNu64 " %d %d %d", &function[functions].address, &function[functions].size,
                   &function[functions].room, &function[functions].phase, &function[functions].mark);
        if (found != 5) {
            break;
        }
        functions++;
    }
    fclose(symbols);
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    qemu_plugin_register_atexit_cb(id, end, NULL);
    return 0;
}
