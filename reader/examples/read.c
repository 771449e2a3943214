/* Prints what the module publishes.
 *
 *   cargo build --release -p freespace-reader
 *   cc -std=c11 -Iinclude reader/examples/read.c target/release/libfreespace_reader.a -lpthread -ldl -lm -o read
 *   ./read [NAME [MESSAGES]]
 */
#define _POSIX_C_SOURCE 200809L
#include "freespace.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static freespace_reader *open_reader(const char *name)
{
    freespace_reader *reader = NULL;
    for (;;) {
        int code = freespace_reader_open(name, &reader);
        if (code == FREESPACE_OK)
            return reader;
        if (code != FREESPACE_NO_MODULE) {
            fprintf(stderr, "%s: %s\n", name, freespace_text(code));
            exit(1);
        }
        fprintf(stderr, "waiting for a module that publishes %s\n", name);
        nanosleep(&(struct timespec){.tv_sec = 1}, NULL);
    }
}

static void print(const freespace_message *message)
{
    static const char *const levels[] = {"full", "no_refinement", "no_fresh_network", "no_fresh_map", "moved", "invalid"};
    uint32_t cells = message->rows * message->columns;
    uint32_t unknown = 0;
    for (uint32_t cell = 0; cell < cells; cell++)
        unknown += message->occupancy[cell] == FREESPACE_UNKNOWN;
    printf("%6" PRIu64 " %-16s age %6.1f ms, free ahead %5.1f m, %" PRIu32 " of %" PRIu32 " cells unknown (not free)\n",
           message->sequence, message->level <= FREESPACE_LEVEL_INVALID ? levels[message->level] : "unknown",
           (double)freespace_age_micros(message) * 1e-3, (double)freespace_free_ahead_m(message, 0.05f), unknown, cells);
}

int main(int argc, char **argv)
{
    char *end = NULL;
    long messages = argc > 2 ? strtol(argv[2], &end, 10) : -1;
    if (argc > 3 || (argc > 1 && argv[1][0] == '-') || (end && (*end || end == argv[2]))) {
        fputs("usage: read [NAME [MESSAGES]]: NAME is that of the module's [shared_memory]\n", stderr);
        return 2;
    }
    const char *name = argc > 1 ? argv[1] : "freespace/grid";
    setvbuf(stdout, NULL, _IOLBF, 0); /* each line leaves at once, into a pipe, too */
    freespace_reader *reader = open_reader(name);
    while (messages != 0) {
        const freespace_message *message = NULL;
        int code = freespace_reader_next(reader, 1000000, &message);
        if (code == FREESPACE_NOTHING) {
            puts("no message for 1 s: nothing is known to be free");
            continue;
        }
        if (code != FREESPACE_OK) {
            fprintf(stderr, "%s: %s\n", name, freespace_text(code));
            return 1;
        }
        print(message);
        messages -= messages > 0;
    }
    freespace_reader_close(reader);
    return 0;
}
