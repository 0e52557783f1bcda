/* SPDX-License-Identifier: MIT */
#include "privileges.h"

#include <errno.h>
#include <grp.h>
#include <limits.h>
#include <linux/capability.h>
#include <pwd.h>
#include <stdbool.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "log.h"
#include "store.h"

static bool become(uid_t user, gid_t group)
{
    struct __user_cap_header_struct head = { .version = _LINUX_CAPABILITY_VERSION_3 };
    const struct __user_cap_data_struct none[_LINUX_CAPABILITY_U32S_3] = { { 0, 0, 0 } };
    const bool is_user = (user == geteuid()) || ((setgroups(0, NULL) == 0) && (setresgid(group, group, group) == 0) &&
                                                 (setresuid(user, user, user) == 0));
    return is_user && (syscall(SYS_capset, &head, none) == 0) && (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0);
}

int node_privileges_drop(const node_options_t *options)
{
    char buffer[PATH_MAX];
    const char *place =
        (options->state != NULL) ? node_store_folder(options->state, buffer, sizeof buffer) : options->config;
    uid_t user = geteuid();
    gid_t group = getegid();
    struct stat entry;
    if (options->user != NULL) {
        const struct passwd *found = getpwnam(options->user);
        if (found == NULL) {
            return node_log("--user %s: no such user; remedy: see `getent passwd`", options->user);
        }
        user = found->pw_uid;
        group = found->pw_gid;
    } else if ((user == 0u) && (stat(place, &entry) == 0)) {
        user = entry.st_uid;
        group = entry.st_gid;
    }
    if (!become(user, group)) {
        return (options->user != NULL)
                   ? node_log("--user %s: cannot be taken (%s); remedy: start as root, or as this user", options->user,
                              strerror(errno))
                   : node_log("%s: user %u, who owns it, cannot be taken (%s); remedy: --user root", place,
                              (unsigned)user, strerror(errno));
    }
    if (access(options->config, R_OK) != 0) {
        node_log("%s: user %u cannot read it (%s), not even after a memory error; remedy: give the user the right to "
                 "read it",
                 options->config, (unsigned)user, strerror(errno));
    }
    return 1;
}
