/* Feeds recorded cycles to zygos_cycle() and says of each call what it was, for a tool that counts its instructions.
   One argument: a file of three uint64 (size of a configuration, size of a cycle, number of cycles), the configuration
   and the cycles as they lie in memory. One word for each call goes to stdout:

       fills     the windows are not full yet, no row
       block     the row opens a new block of the normal equations
       arc       the row ends its arc, or that of the motor or momentum rows
       cycle     any other row

   and behind it the turn it was. */

#include "zygos/zygos.h"

#include <inttypes.h>
#include <stdio.h>

static zygos_t arm;

static int refuse(const char *why)
{
    fprintf(stderr, "%s\n", why);
    return 1;
}

int main(int count, char **argument)
{
    FILE *file = (count == 2) ? fopen(argument[1], "rb") : NULL;
    uint64_t head[3];
    zygos_config_t config;
    if ((file == NULL) || (fread(head, sizeof head, 1, file) != 1)) {
        return refuse("one argument: a file of a configuration and cycles");
    }
    if ((head[0] != sizeof config) || (head[1] != sizeof(zygos_cycle_t)) ||
        (fread(&config, sizeof config, 1, file) != 1)) {
        return refuse("the file was written with other headers or capacities");
    }
    if (zygos_init(&arm, &config) < 0) {
        return refuse("the configuration is refused");
    }
    for (uint64_t k = 0; k < head[2]; k++) {
        zygos_cycle_t cycle;
        if (fread(&cycle, sizeof cycle, 1, file) != 1) {
            return refuse("cycles are missing");
        }
        const zygos_accumulator_t *sums = &arm.accumulator;
        const uint32_t blocks = sums->count;
        const uint32_t arcs = sums->arcs + sums->arcs_dropped;
        if (zygos_cycle(&arm, &cycle) != 1) {
            return refuse("a cycle is not valid");
        }
        const bool others = ((config.impulse_arc_cycles > 0) && (arm.joint_sums.cycles == 0)) ||
                            ((config.momentum_arc_cycles > 0) && (arm.momentum_sums.cycles == 0));
        const bool ended =
            (sums->arcs + sums->arcs_dropped != arcs) || ((arm.instant == 1) && ((arm.arc == 0) || others));
        printf("%s", (arm.instant != 1) ? "fills" : ended ? "arc" : (sums->count != blocks) ? "block" : "cycle");
        /* Whose turn it was, how far the step has filled, and whether it is the arc's first, behind which none is
           shared out: what a cycle costs may depend on that. */
        const uint32_t sensors = (config.compensation > 0) ? config.compensation : 1u;
        printf(" %" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%d,%d\n", (arm.arc + sensors - 1u) % sensors,
               arm.joint_sums.cycles % config.joints, arm.momentum_sums.cycles % (3u * (config.joints + 3u)),
               (int)sums->filled, (arm.arc <= (uint32_t)ZYGOS_STEP) ? 1 : 0);
    }
    printf("parameters %" PRIu32 "\n", arm.layout.count);
    return (fclose(file) == 0) ? 0 : 1;
}
