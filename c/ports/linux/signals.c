/* SPDX-License-Identifier: MIT */
#include "signals.h"

#include <stdint.h>
#include <string.h>

static const int ending[] = { SIGTERM, SIGINT, SIGHUP };
#define ENDING (sizeof ending / sizeof ending[0])

static volatile sig_atomic_t end_requested;

static void request_end(int signal_number)
{
    (void)signal_number;
    end_requested = 1;
}

static void answer(int signal_number, void (*how)(int))
{
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = how;
    (void)sigaction(signal_number, &action, NULL);
}

static bool is_ignored(int signal_number)
{
    struct sigaction action;
    return (sigaction(signal_number, NULL, &action) == 0) && (action.sa_handler == SIG_IGN);
}

void node_signals_ignore(void)
{
    answer(SIGPIPE, SIG_IGN);
    answer(SIGXFSZ, SIG_IGN);
}

sigset_t node_signals_catch(void)
{
    sigset_t blocked;
    sigset_t while_waiting;
    (void)sigemptyset(&blocked);
    for (uint32_t i = 0; i < ENDING; i++) {
        if ((ending[i] != SIGHUP) || !is_ignored(SIGHUP)) {
            answer(ending[i], request_end);
            (void)sigaddset(&blocked, ending[i]);
        }
    }
    (void)sigprocmask(SIG_BLOCK, &blocked, &while_waiting);
    for (uint32_t i = 0; i < ENDING; i++) {
        (void)sigdelset(&while_waiting, ending[i]);
    }
    return while_waiting;
}

bool node_signals_ended(void)
{
    sigset_t pending;
    bool ended = (end_requested != 0);
    (void)sigpending(&pending);
    for (uint32_t i = 0; i < ENDING; i++) {
        ended = ended || (sigismember(&pending, ending[i]) == 1);
    }
    return ended;
}
