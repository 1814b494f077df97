/* Keeps the monotonic clock out of libfaketime's hands; to be preloaded before it. Its version in Debian 12 takes it for
 * the clock that it shifts when it is to sleep by it (its issue 426: Python 3.11 then cannot sleep at all), and makes
 * every look at it wait for a lock that all processes share. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *request, struct timespec *remain)
{
    return syscall(SYS_clock_nanosleep, clock, flags, request, remain) ? errno : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    static int (*next)(clockid_t, struct timespec *);

    if (clock == CLOCK_MONOTONIC)
        return syscall(SYS_clock_gettime, clock, now);
    if (!next)
        next = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    return next(clock, now);
}
