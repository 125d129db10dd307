/* A disk that fails, is full or is slow: preloaded into the service.

   Only files below FAULTY_DISK_BELOW, only while the file FAULTY_DISK_SWITCH exists. What it holds says how: 'full', no
   write finds room; 'slow', a sync takes SLOW_SYNC_MS and one in PER of the writes SLOW_WRITE_MS; else one in PER of the
   writes finds no room and one in PER of the syncs fails. Every failure is a line in the file FAULTY_DISK_LOG
   ("sync /path", "write /path"). Which call fails follows from FAULTY_DISK_SEED, the number of the call
   in its process, and how long the log was when the process began: a process that is started again fails elsewhere.
   A sync that fails leaves the data in the kernel, where a restart finds it; a write that fails writes nothing. */

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { PER = 20, SLOW_SYNC_MS = 300, SLOW_WRITE_MS = 50 };

static const char *below, *log_path, *switch_path;
static uint64_t seed;
static _Atomic uint64_t calls;

__attribute__((constructor)) static void prepare(void) {
    struct stat log;
    below = getenv("FAULTY_DISK_BELOW");
    log_path = getenv("FAULTY_DISK_LOG");
    switch_path = getenv("FAULTY_DISK_SWITCH");
    const char *given = getenv("FAULTY_DISK_SEED");
    uint64_t logged = log_path && stat(log_path, &log) == 0 ? (uint64_t)log.st_size : 0;
    seed = (given ? strtoull(given, NULL, 10) : 0) * 1000003u + logged;
}

/* splitmix64: every bit of the result depends on every bit of x. */
static uint64_t mixed(uint64_t x) {
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

static int is_below(int fd, char *path) {
    char link[32];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, PATH_MAX - 1);
    if (length < 0) return 0;
    path[length] = '\0';
    size_t folder = strlen(below);
    return strncmp(path, below, folder) == 0 && path[folder] == '/';
}

static void note(const char *what, const char *path) {
    char line[PATH_MAX + 16];
    int length = snprintf(line, sizeof line, "%s %s\n", what, path);
    int log = open(log_path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
    if (log < 0) return;
    syscall(SYS_write, log, line, (size_t)length);
    close(log);
}

/* The first letter in the switch: 'f' for full, 's' for slow, ' ' where it is empty; 0 where there is none. */
static char trouble(void) {
    char how = ' ';
    int file = switch_path ? open(switch_path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return 0;
    if (syscall(SYS_read, file, &how, 1) < 0) how = ' ';
    close(file);
    return how;
}

static void wait_ms(long ms) {
    struct timespec left = {ms / 1000, ms % 1000 * 1000000};
    while (nanosleep(&left, &left) != 0 && errno == EINTR) {
    }
}

/* Whether this call fails; errno is then `number`, and else what it was. */
static int fails(int fd, const char *what, int number) {
    char path[PATH_MAX], how = 0;
    int before = errno, sync = number == EIO;
    int meant = below && log_path && (how = trouble()) != 0 && is_below(fd, path);
    int chosen = meant && mixed(seed + mixed(atomic_fetch_add(&calls, 1))) % PER == 0;
    if (meant && how == 's' && (sync || chosen)) wait_ms(sync ? SLOW_SYNC_MS : SLOW_WRITE_MS);
    int unlucky = meant && (how == 'f' ? !sync : how != 's' && chosen);
    if (unlucky) note(what, path);
    errno = unlucky ? number : before;
    return unlucky;
}

int fsync(int fd) { return fails(fd, "sync", EIO) ? -1 : (int)syscall(SYS_fsync, fd); }

int fdatasync(int fd) { return fails(fd, "sync", EIO) ? -1 : (int)syscall(SYS_fdatasync, fd); }

ssize_t write(int fd, const void *data, size_t size) {
    return fails(fd, "write", ENOSPC) ? -1 : syscall(SYS_write, fd, data, size);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    return fails(fd, "write", ENOSPC) ? -1 : syscall(SYS_writev, fd, parts, count);
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t at) {
    return fails(fd, "write", ENOSPC) ? -1 : syscall(SYS_pwrite64, fd, data, size, at);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    return fails(fd, "write", ENOSPC) ? -1 : syscall(SYS_pwrite64, fd, data, size, at);
}
