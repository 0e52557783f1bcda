/* Feeds recorded frames to the library and says of each cycle what it was, for a tool that counts its instructions.
   One argument: a file of three uint64 (size of a configuration, size of a frame, number of frames), the configuration
   and the frames as they lie in memory. The first line on stdout is p and the bytes of state, of this build, of each
   stage. Then a line for each cycle:

       fills     the windows are not full yet, no row
       block     the row opens a new block of the normal equations
       arc       the row ends its arc, or that of the motor or momentum rows
       cycle     any other row

   and behind it the place of the cycle: whose turn it is, and where rings and steps stand. At the end the estimate is
   solved once. */

#include "zygos/zygos.h"

#include <inttypes.h>
#include <stdio.h>

static zygos_t arm;
static zygos_work_t work;
static zygos_estimate_t estimate;

void driver_mark(void);

/* What counts instructions sees this call behind each cycle. */
__attribute__((noinline)) void driver_mark(void)
{
    __asm__ volatile("" ::: "memory");
}

static int refuse(const char *why)
{
    fprintf(stderr, "%s\n", why);
    return 1;
}

static void say_sizes(void)
{
    printf("wire=0 cycle=%zu smoother=%zu kinematics=%zu balance=%zu impulse=%zu momentum=%zu noise=%zu ",
           sizeof(zygos_receiver_t) + sizeof(zygos_hold_t), sizeof(zygos_smoother_t) + sizeof(zygos_state_t),
           sizeof(zygos_skeleton_t) + sizeof(zygos_motion_t), sizeof(zygos_balance_t) + sizeof(zygos_row_t),
           sizeof(zygos_impulse_t) + sizeof(zygos_impulse_rows_t) + sizeof(zygos_joint_sums_t),
           sizeof(zygos_momentum_t) + sizeof(zygos_momentum_sums_t), sizeof(zygos_noise_t));
    printf("accumulator=%zu solver=%zu frame=%zu step=%zu solve=%zu parameters=%" PRIu32 "\n",
           sizeof(zygos_accumulator_t), sizeof(zygos_work_t) + sizeof(zygos_estimate_t), sizeof(zygos_t),
           sizeof(zygos_t), sizeof(zygos_work_t) + sizeof(zygos_estimate_t), arm.layout.count);
}

static void step(uint32_t frames)
{
    const zygos_accumulator_t *sums = &arm.accumulator;
    const zygos_config_t *config = &arm.config;
    const uint32_t blocks = sums->count;
    const uint32_t arcs = sums->arcs + sums->arcs_dropped;
    (void)zygos_step(&arm);
    driver_mark();
    const bool others = ((config->impulse_arc_cycles > 0) && (arm.joint_sums.cycles == 0)) ||
                        ((config->momentum_arc_cycles > 0) && (arm.momentum_sums.cycles == 0));
    const bool ended = (sums->arcs + sums->arcs_dropped != arcs) || ((arm.instant == 1) && ((arm.arc == 0) || others));
    const uint32_t sensors = (config->compensation > 0) ? config->compensation : 1u;
    printf("%s %" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%" PRIu32 ",%d\n",
           (arm.instant != 1) ? "fills" : (ended ? "arc" : ((sums->count != blocks) ? "block" : "cycle")), frames,
           (arm.arc + sensors - 1u) % sensors, arm.joint_sums.cycles % config->joints,
           arm.momentum_sums.cycles % (3u * (config->joints + 3u)), sums->filled, arm.balance.torque_at,
           arm.smoother.position, (arm.arc <= (uint32_t)ZYGOS_STEP) ? 1 : 0);
}

int main(int count, char **argument)
{
    FILE *file = (count == 2) ? fopen(argument[1], "rb") : NULL;
    uint64_t head[3];
    zygos_config_t config;
    if ((file == NULL) || (fread(head, sizeof head, 1, file) != 1)) {
        return refuse("one argument: a file of a configuration and frames");
    }
    if ((head[0] != sizeof config) || (head[1] != sizeof(zygos_frame_t)) ||
        (fread(&config, sizeof config, 1, file) != 1)) {
        return refuse("the file was written with other headers or capacities");
    }
    if (zygos_init(&arm, &config) < 0) {
        return refuse("the configuration is refused");
    }
    say_sizes();
    uint32_t frames = 0;
    for (uint64_t k = 0; k < head[2]; k++) {
        zygos_frame_t frame;
        if (fread(&frame, sizeof frame, 1, file) != 1) {
            return refuse("frames are missing");
        }
        if (zygos_frame(&arm, &frame) != ZYGOS_ACCEPTED) {
            return refuse("a frame is not accepted");
        }
        frames++;
        if (arm.receiver.queue.head != arm.receiver.queue.tail) {
            step(frames);
            frames = 0;
        }
    }
    zygos_take(&arm, &work);
    (void)zygos_solve(&work, &estimate);
    printf("rank %" PRIu32 "\n", estimate.rank);
    return (fclose(file) == 0) ? 0 : 1;
}
