/* SPDX-License-Identifier: MIT */
#include "bus.h"

#include <errno.h>
#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>

#include "log.h"

/* A second of a full bus at 1 Mbit/s, 9,000 frames, at what the kernel accounts for each. */
#define RECEIVE_BUFFER (8 * 1024 * 1024)
#define MOST_FILTERS (2u * ZYGOS_MAX_JOINTS + 4u)
/* Room for the count of drops beside each packet. */
#define CONTROL 64u

/* Exactly these identifiers, as data frames with 11 bits. */
static uint32_t filters_of(const zygos_config_t *config, struct can_filter *filter)
{
    uint32_t id[MOST_FILTERS];
    uint32_t count = 0;
    id[count++] = ZYGOS_ID_SYNC;
    id[count++] = ZYGOS_ID_TPDO3 + ZYGOS_NODE_COMPUTER;
    for (uint32_t i = 0; i < config->joints; i++) {
        id[count++] = ZYGOS_ID_TPDO1 + config->joint[i].node;
        id[count++] = ZYGOS_ID_TPDO2 + config->joint[i].node;
    }
    if (config->imu_node != 0u) {
        id[count++] = ZYGOS_ID_TPDO1 + config->imu_node;
        id[count++] = ZYGOS_ID_TPDO3 + config->imu_node;
    }
    for (uint32_t i = 0; i < count; i++) {
        filter[i].can_id = id[i];
        filter[i].can_mask = CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG;
    }
    return count;
}

static bool set(int fd, int level, int name, const void *value, size_t size)
{
    return setsockopt(fd, level, name, value, (socklen_t)size) == 0;
}

static bool ask_for_frames(int fd, const zygos_config_t *config)
{
    struct can_filter filter[MOST_FILTERS];
    const uint32_t count = filters_of(config, filter);
    const can_err_mask_t errors = CAN_ERR_BUSOFF | CAN_ERR_CRTL | CAN_ERR_ACK;
    const int no = 0;
    return set(fd, SOL_CAN_RAW, CAN_RAW_FILTER, filter, count * sizeof filter[0]) &&
           set(fd, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors) &&
           set(fd, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &no, sizeof no);
}

static bool bind_to(int fd, const char *interface)
{
    struct sockaddr_can address;
    memset(&address, 0, sizeof address);
    address.can_family = AF_CAN;
    address.can_ifindex = (int)if_nametoindex(interface);
    return (address.can_ifindex != 0) && (bind(fd, (const struct sockaddr *)&address, sizeof address) == 0);
}

static int option_of(int fd, int name)
{
    int value = -1;
    socklen_t size = sizeof value;
    return (getsockopt(fd, SOL_SOCKET, name, &value, &size) == 0) ? value : -1;
}

/* Buffer, filters and the count of drops. */
static bool prepare(int fd, bool can, const zygos_config_t *config)
{
    const int yes = 1;
    const int room = RECEIVE_BUFFER;
    if (!set(fd, SOL_SOCKET, SO_RCVBUFFORCE, &room, sizeof room)) {
        (void)set(fd, SOL_SOCKET, SO_RCVBUF, &room, sizeof room); /* as much as this user may have */
    }
    return set(fd, SOL_SOCKET, SO_RXQ_OVFL, &yes, sizeof yes) && (!can || ask_for_frames(fd, config));
}

int node_bus_open(node_bus_t *self, const node_options_t *options, const zygos_config_t *config)
{
    memset(self, 0, sizeof *self);
    self->fd = options->fd;
    self->interface = options->interface;
    if (self->interface != NULL) {
        self->fd = socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
        if (self->fd < 0) {
            return node_log("no CAN socket here (%s); remedy: modprobe can_raw", strerror(errno));
        }
    }
    const int type = option_of(self->fd, SO_TYPE);
    const bool can = (option_of(self->fd, SO_DOMAIN) == AF_CAN);
    if ((type != SOCK_SEQPACKET) && (type != SOCK_DGRAM) && !(can && (type == SOCK_RAW))) {
        return node_log("--fd %d: no socket of packets; remedy: CAN_RAW, SOCK_SEQPACKET or SOCK_DGRAM", self->fd);
    }
    self->stream_ends = (type == SOCK_SEQPACKET);
    if (!prepare(self->fd, can, config)) {
        return node_log("the socket takes no options (%s); remedy: use a newer kernel", strerror(errno));
    }
    if ((self->interface != NULL) && !bind_to(self->fd, self->interface)) {
        return node_log("%s: cannot be opened (%s); remedy: see `ip link`, and set it up", self->interface,
                        strerror(errno));
    }
    return 1;
}

/* The socket keeps its buffer, for which a new one would need a privilege again; its filters went with the interface.
 */
void node_bus_again(node_bus_t *self, const zygos_config_t *config)
{
    if (self->away && ask_for_frames(self->fd, config) && bind_to(self->fd, self->interface)) {
        self->away = false;
        node_log("%s: is back", self->interface);
    }
}

/* What the library is given of a packet. CAN FD frames are foreign to it, so that of theirs eight bytes will do. */
static zygos_frame_t frame_of(const struct canfd_frame *in, bool fd)
{
    zygos_frame_t out;
    memset(&out, 0, sizeof out);
    const bool error = (in->can_id & CAN_ERR_FLAG) != 0u;
    const bool extended = (in->can_id & CAN_EFF_FLAG) != 0u;
    out.id = in->can_id & ((error || extended) ? CAN_EFF_MASK : CAN_SFF_MASK);
    out.length = in->len;
    out.flags = (uint8_t)((extended ? (uint32_t)ZYGOS_FRAME_EXTENDED : 0u) |
                          ((in->can_id & CAN_RTR_FLAG) ? (uint32_t)ZYGOS_FRAME_REMOTE : 0u) |
                          (error ? (uint32_t)ZYGOS_FRAME_ERROR : 0u) | (fd ? (uint32_t)ZYGOS_FRAME_FD : 0u));
    memcpy(out.data, in->data, sizeof out.data);
    return out;
}

/* The kernel counts drops since the socket was opened, modulo 2^32, and tells with each packet. */
static void count_drops(node_bus_t *self, struct msghdr *message)
{
    for (struct cmsghdr *c = CMSG_FIRSTHDR(message); c != NULL; c = CMSG_NXTHDR(message, c)) {
        if ((c->cmsg_level == SOL_SOCKET) && (c->cmsg_type == SO_RXQ_OVFL)) {
            uint32_t drops;
            memcpy(&drops, CMSG_DATA(c), sizeof drops);
            self->losses.overflow += drops - self->drops;
            self->drops = drops;
        }
    }
}

void node_bus_wait(const node_bus_t *self, double seconds, const sigset_t *mask)
{
    const double wait_s = (seconds > 0.0) ? seconds : 0.0;
    const struct timespec timeout = { .tv_sec = (time_t)wait_s,
                                      .tv_nsec = (long)(1e9 * (wait_s - (double)(time_t)wait_s)) };
    struct pollfd socket_of = { .fd = self->fd, .events = POLLIN };
    (void)ppoll(&socket_of, 1, &timeout, mask);
}

static int read_failed(node_bus_t *self)
{
    switch (errno) {
    case EINTR:
        return NODE_READ;
    case EAGAIN:
        return NODE_EMPTY;
    case ENOBUFS:
    case ENOMEM: /* the kernel is short of memory for a while */
        return NODE_EMPTY;
    case ENETDOWN: /* the interface went down: what is lost is noticed by the counters of SYNC and FTIME */
        self->losses.down++;
        return NODE_READ;
    case ECONNREFUSED: /* the other end of a socket of datagrams is not there */
    case ECONNRESET:   /* it closed with our answers unread; what it sent before is still to be read */
        return NODE_READ;
    case ENODEV: /* the interface was removed, as an adapter that is unplugged */
    case ENXIO:
        if (self->interface != NULL) {
            node_log("%s: was removed (%s), waits for it; remedy: see `ip link`, and set it up again", self->interface,
                     strerror(errno));
            self->away = true;
            self->losses.down++;
            return NODE_EMPTY;
        }
        /* fall through */
    default:
        node_log("cannot receive any more (%s); remedy: see `ip link`, and start again", strerror(errno));
        return NODE_FAILED;
    }
}

int node_bus_read(node_bus_t *self, zygos_frame_t *frame, uint32_t *count)
{
    struct canfd_frame packet[NODE_BATCH];
    struct iovec place[NODE_BATCH];
    struct mmsghdr message[NODE_BATCH];
    _Alignas(struct cmsghdr) char control[NODE_BATCH][CONTROL];
    memset(message, 0, sizeof message);
    for (uint32_t i = 0; i < NODE_BATCH; i++) {
        place[i] = (struct iovec){ .iov_base = &packet[i], .iov_len = sizeof packet[i] };
        message[i].msg_hdr.msg_iov = &place[i];
        message[i].msg_hdr.msg_iovlen = 1;
        message[i].msg_hdr.msg_control = control[i];
        message[i].msg_hdr.msg_controllen = CONTROL;
    }
    *count = 0;
    const int got = recvmmsg(self->fd, message, NODE_BATCH, MSG_DONTWAIT, NULL);
    if (got < 0) {
        return read_failed(self);
    }
    for (int i = 0; i < got; i++) {
        const uint32_t length = message[i].msg_len;
        count_drops(self, &message[i].msg_hdr);
        if ((length == 0u) && self->stream_ends) {
            return NODE_ENDED;
        }
        const bool whole = (message[i].msg_hdr.msg_flags & MSG_TRUNC) == 0;
        if (!whole || ((length != CAN_MTU) && (length != CANFD_MTU))) {
            self->losses.misshapen++;
            continue;
        }
        frame[(*count)++] = frame_of(&packet[i], length == CANFD_MTU);
    }
    return NODE_READ;
}

void node_bus_send(node_bus_t *self, const zygos_frame_t *frame)
{
    struct can_frame out;
    memset(&out, 0, sizeof out);
    out.can_id = frame->id;
    out.len = frame->length;
    memcpy(out.data, frame->data, sizeof out.data);
    const ssize_t sent = send(self->fd, &out, sizeof out, MSG_DONTWAIT | MSG_NOSIGNAL);
    self->losses.unsent += (sent == (ssize_t)sizeof out) ? 0u : 1u;
}
