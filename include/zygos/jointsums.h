/// zygos/jointsums.h: the normal equations of the motor impulse rows, a small set for each joint.
///
/// The rows of a joint know its own parameters only, so their sums stay apart from those of the energy until the solver
/// adds both, each weighted by what its own scores say of its noise. What the sensors' noise adds is the same at every
/// instant, and is taken off when an arc ends. The noise that the integral of the deflection sums up is alike over a
/// whole arc, so blocks are whole arcs; when all are in use, neighbours merge.

#ifndef ZYGOS_JOINTSUMS_H
#define ZYGOS_JOINTSUMS_H

#include "impulse.h"
#include "types.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Blocks of whole arcs.
#ifndef ZYGOS_MAX_JOINT_BLOCKS
#define ZYGOS_MAX_JOINT_BLOCKS 32
#endif
#if (ZYGOS_MAX_JOINT_BLOCKS < 4) || (ZYGOS_MAX_JOINT_BLOCKS > 256) || (ZYGOS_MAX_JOINT_BLOCKS % 2 != 0)
#error "ZYGOS_MAX_JOINT_BLOCKS must be even, 4..256"
#endif

/// A row of a joint, augmented by the impulse and by 1.
#define ZYGOS_MAX_JOINT_ROW (ZYGOS_MAX_IMPULSE + 2)
#define ZYGOS_MAX_PACKED_JOINT (ZYGOS_MAX_JOINT_ROW * (ZYGOS_MAX_JOINT_ROW + 1) / 2)

/// Sum of z z^T of z = [columns, impulse, 1], lower triangle row by row, and its row sums.
typedef struct {
    double gram[ZYGOS_MAX_PACKED_JOINT];
    double sum[ZYGOS_MAX_JOINT_ROW];
} zygos_joint_gram_t;

typedef struct {
    zygos_joint_gram_t joint[ZYGOS_MAX_JOINTS]; ///< Closed: the constants eliminated, the noise taken off.
    double instants[ZYGOS_MAX_JOINTS];          ///< Accepted ones that were a joint's turn.
    double total;                               ///< Accepted ones in all.
    uint64_t end;                               ///< Number of the newest cycle.
    uint64_t checksum;                          ///< Of instants, total and end, when the arc has closed.
} zygos_joint_block_t;

typedef struct {
    zygos_impulse_column_map_t column_map;
    double noise[ZYGOS_MAX_JOINTS][ZYGOS_MAX_PACKED_IMPULSE]; ///< Of one instant.
    uint32_t count;                                           ///< Blocks of closed arcs.
    uint32_t corrupt;  ///< 1: the row sums of an arc did not match when it closed.
    uint32_t instants; ///< Accepted instants of the open arc.
    uint32_t cycles;   ///< Instants of the open arc, accepted or not.
    double target;     ///< Instants up to which blocks merge.
    uint64_t checksum; ///< Of count and target.
    zygos_joint_block_t open;
    zygos_joint_block_t block[ZYGOS_MAX_JOINT_BLOCKS];
} zygos_joint_sums_t;

/// What follows from the configuration: the layout, and what noise adds in an instant. The sums stay.
/// Needs a checked configuration.
void zygos_joint_sums_tables(zygos_joint_sums_t *self, const zygos_config_t *config, const zygos_smoother_t *smoother);

/// Whether every place and count exists for a checked configuration: the other calls rely on that, and do not look.
/// Cost: a comparison a block and an entry of the layout.
bool zygos_joint_sums_intact(const zygos_joint_sums_t *self, const zygos_config_t *config);

/// Empties the sums; the tables stay.
void zygos_joint_sums_clear(zygos_joint_sums_t *self, const zygos_config_t *config);

/// Adds the row of the joint whose turn it is with weight 1 or 0: joints take turns, for the noise of neighbouring
/// instants is much the same. Cost: one small rank-1 update.
void zygos_joint_sums_add(zygos_joint_sums_t *self, const zygos_config_t *config, const zygos_impulse_rows_t *rows,
                          double weight);

/// Ends the open arc, whose newest cycle is the given one: eliminates its constants and takes its noise off, or drops
/// it when it is too short. Cost: the sums of all joints once; at the worst one merge of all blocks.
void zygos_joint_sums_end_arc(zygos_joint_sums_t *self, const zygos_config_t *config, uint64_t cycle);

/// The same in two steps. Closing eliminates the constants and returns true, or drops an arc that is too short and
/// returns false. A closed arc is in self->open until the next call admits it to the blocks, or leaves it out.
bool zygos_joint_sums_close(zygos_joint_sums_t *self, const zygos_config_t *config);
void zygos_joint_sums_admit(zygos_joint_sums_t *self, uint64_t cycle);
void zygos_joint_sums_leave_out(zygos_joint_sums_t *self);

/// Multiplies all that closed arcs left by a factor.
void zygos_joint_sums_forget(zygos_joint_sums_t *self, double factor);

/// Drops the open arc, and the blocks that reach beyond the given cycle.
void zygos_joint_sums_drop_after(zygos_joint_sums_t *self, uint64_t cycle);

/// Drops the blocks up to the given cycle, and returns how many.
uint32_t zygos_joint_sums_drop_until(zygos_joint_sums_t *self, uint64_t cycle);

/// 2 when row sums or a seal do not match, else at most 1. Needs sums that are intact.
double zygos_joint_sums_check(const zygos_joint_sums_t *self, const zygos_config_t *config);

#ifdef __cplusplus
}
#endif
#endif
