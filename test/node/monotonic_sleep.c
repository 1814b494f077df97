/* Sleeps by the kernel's own clocks under libfaketime, whose version in Debian 12 takes the monotonic clock for the one
 * that it shifts (its issue 426): Python 3.11 then cannot sleep at all. To be preloaded before it. */
#include <errno.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *request, struct timespec *remain)
{
    return syscall(SYS_clock_nanosleep, clock, flags, request, remain) ? errno : 0;
}
