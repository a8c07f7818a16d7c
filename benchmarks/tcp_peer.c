/* A TCP ping-pong in C for bench_node.py, which compiles it: `tcp_peer echo PORT BYTES`, `tcp_peer ping PORT BYTES RATE MESSAGES`.
   An echo prints `ready`; a ping prints the round-trip times of its messages in ns, as JSON. */
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

static long now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000L + t.tv_nsec;
}

static int move_all(int socket, char *data, long bytes, int sends) {
    for (long done = 0; done < bytes;) {
        long count = sends ? send(socket, data + done, bytes - done, MSG_NOSIGNAL) : recv(socket, data + done, bytes - done, 0);
        if (count <= 0) return 0;
        done += count;
    }
    return 1;
}

int main(int count, char **words) {
    if (count < 4) return 2;
    int pings = !strcmp(words[1], "ping"), one = 1, end = socket(AF_INET, SOCK_STREAM, 0);
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(atoi(words[2])), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    long bytes = atol(words[3]);
    char *data = calloc(bytes, 1);
    setsockopt(end, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (!pings) {
        if (bind(end, (struct sockaddr *)&address, sizeof address) || listen(end, 1)) return perror("bind"), 1;
        puts("ready");
        fflush(stdout);
        int other = accept(end, 0, 0);
        setsockopt(other, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
        while (move_all(other, data, bytes, 0) && move_all(other, data, bytes, 1)) {}
        return 0;
    }
    if (count < 6) return 2;
    if (connect(end, (struct sockaddr *)&address, sizeof address)) return perror("connect"), 1;
    setsockopt(end, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    long period_ns = 1000000000L / atol(words[4]), messages = atol(words[5]), due_ns = now_ns();
    for (long number = 0; number < messages; number++) {
        due_ns += period_ns;
        struct timespec due = {due_ns / 1000000000L, due_ns % 1000000000L};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, 0);
        long sent_ns = now_ns();
        if (!move_all(end, data, bytes, 1) || !move_all(end, data, bytes, 0)) return 1;
        printf("%s%ld", number ? ", " : "[", now_ns() - sent_ns);
    }
    puts("]");
    return 0;
}
