/* SPDX-License-Identifier: MIT */
#include "options.h"

#include <errno.h>
#include <getopt.h>
#include <limits.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include "log.h"

static const char help[] =
    "usage: zygos-node --config arm.zyg (-i CAN | --fd N) [--state FILE [--save-every SYNCS]]\n"
    "                  [--every SYNCS] [--refine SHARE] [--exit-idle SECONDS] [--user NAME]\n"
    "\n"
    "Learns an arm's dynamics from the frames of a CAN interface, and answers on it with estimates, intervals and "
    "fault\n"
    "counters (0x1A0) and a heartbeat (0x720). SIGTERM, SIGINT or SIGHUP: works off what has been received, saves, "
    "ends.\n"
    "\n"
    "  --config FILE        the arm, written by `zygos compile-model`\n"
    "  -i, --interface CAN  interface to receive from and to answer on, for instance can0\n"
    "  --fd N               instead: an open CAN_RAW socket, or another that carries struct can_frame in packets\n"
    "  --state FILE         go on from this file, or from FILE.previous, if it can be used; save at the end\n"
    "  --save-every SYNCS   also from one save to the next; what came since is lost with the power\n"
    "  --every SYNCS        from one estimate to the next (100); its values are sent in between\n"
    "  --refine SHARE       also refine the estimate; SHARE: noise of the torques divided by their size, 0: none "
    "declared\n"
    "  --exit-idle SECONDS  end when no frame came for so long\n"
    "  --user NAME          started as root: become this user once the socket is open (the owner of the folder of "
    "the\n"
    "                       state, or without --state of the configuration)\n"
    "\n"
    "Exit codes: 0 ended as told; 2 an option or the configuration was refused, or the state could not be saved.\n";

/* The value of an option, within limits. Returns false after logging the reason. */
static bool number(const char *option, const char *text, double low, double high, double *out)
{
    char *end = NULL;
    errno = 0;
    *out = strtod(text, &end);
    if ((end == text) || (*end != '\0') || (errno != 0) || !((*out >= low) && (*out <= high))) {
        node_log("--%s %s: no number from %g to %g; remedy: see --help", option, text, low, high);
        return false;
    }
    return true;
}

static bool whole(const char *option, const char *text, double low, double high, double *out)
{
    if (!number(option, text, low, high, out)) {
        return false;
    }
    if (floor(*out) < *out) {
        node_log("--%s %s: no whole number; remedy: see --help", option, text);
        return false;
    }
    return true;
}

int node_options_read(int argc, char **argv, node_options_t *out)
{
    static const struct option known[] = { { "config", required_argument, NULL, 'c' },
                                           { "interface", required_argument, NULL, 'i' },
                                           { "fd", required_argument, NULL, 'f' },
                                           { "state", required_argument, NULL, 's' },
                                           { "every", required_argument, NULL, 'e' },
                                           { "save-every", required_argument, NULL, 'v' },
                                           { "refine", required_argument, NULL, 'r' },
                                           { "exit-idle", required_argument, NULL, 'x' },
                                           { "user", required_argument, NULL, 'u' },
                                           { "help", no_argument, NULL, 'h' },
                                           { NULL, 0, NULL, 0 } };
    *out = (node_options_t){ .fd = -1, .every = 100u, .refine = -1.0 };
    double value = 0.0;
    for (int letter = 0; letter != -1;) {
        letter = getopt_long(argc, argv, "i:h", known, NULL);
        switch (letter) {
        case -1:
            break;
        case 'c':
            out->config = optarg;
            break;
        case 'i':
            out->interface = optarg;
            break;
        case 'f':
            if (!whole("fd", optarg, 0.0, INT_MAX, &value)) {
                return -1;
            }
            out->fd = (int)value;
            break;
        case 's':
            out->state = optarg;
            break;
        case 'e':
            if (!whole("every", optarg, 1.0, 1e9, &value)) {
                return -1;
            }
            out->every = (uint32_t)value;
            break;
        case 'v':
            if (!whole("save-every", optarg, 0.0, 1e9, &value)) {
                return -1;
            }
            out->save_every = (uint32_t)value;
            break;
        case 'r':
            if (!number("refine", optarg, 0.0, 1.0, &out->refine)) {
                return -1;
            }
            break;
        case 'x':
            if (!number("exit-idle", optarg, 0.1, 1e9, &out->idle_s)) {
                return -1;
            }
            break;
        case 'u':
            out->user = optarg;
            break;
        case 'h':
            fputs(help, stdout);
            return 0;
        default: /* getopt has printed what is wrong */
            return node_log("remedy: see --help");
        }
    }
    if (optind < argc) {
        return node_log("%s: not an option; remedy: see --help", argv[optind]);
    }
    if (out->config == NULL) {
        return node_log("no configuration; remedy: --config arm.zyg, written by `zygos compile-model`");
    }
    if ((out->save_every > 0u) && (out->state == NULL)) {
        return node_log("--save-every without a file to save into; remedy: --state FILE");
    }
    if ((out->interface == NULL) == (out->fd < 0)) {
        return node_log("either an interface or a descriptor is needed; remedy: -i can0, or --fd N");
    }
    return 1;
}
