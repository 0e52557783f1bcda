/* SPDX-License-Identifier: MIT */
#include "lock.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <unistd.h>

#include "log.h"

int node_lock(const char *path)
{
    char name[PATH_MAX];
    (void)snprintf(name, sizeof name, "%s.lock", path);
    const int fd = open(name, O_RDONLY | O_CREAT | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0644);
    if ((fd >= 0) && (flock(fd, LOCK_EX | LOCK_NB) == 0)) {
        return fd;
    }
    const int why = errno;
    if (fd >= 0) {
        (void)close(fd);
    }
    if (why == EWOULDBLOCK) {
        return node_log("%s: another node has this state in use; remedy: end it, or name another file with --state",
                        path);
    }
    return node_log("%s: cannot be locked (%s); remedy: remove it, or keep the state where files can be locked", name,
                    strerror(why));
}
