/* The topics of a rig with Cyclone DDS's C library, for dds_cost.rs: what examples/dds_load.rs does.
 *
 * load source RATE SIZE RELIABLE …   publishes to load0, load1, … until it is killed
 * load sink RATE SIZE RELIABLE …     subscribes to them and prints the total once a second
 */
#include "dds/dds.h"
#include "load.h"
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST 16

struct topic {
  double rate;
  uint32_t size;
  dds_entity_t endpoint;
  dds_time_t due;
};

static void check(int32_t result, const char *what)
{
  if (result < 0) {
    fprintf(stderr, "%s: %s\n", what, dds_strretcode(-result));
    exit(1);
  }
}

static void publish(struct topic *topics, int count)
{
  Bytes message;
  memset(&message, 0, sizeof message);
  for (int i = 0; i < count; i++)
    topics[i].due = dds_time();
  for (;;) {
    struct topic *next = topics;
    for (int i = 1; i < count; i++)
      if (topics[i].due < next->due)
        next = &topics[i];
    dds_time_t now = dds_time();
    if (next->due > now)
      dds_sleepfor(next->due - now);
    next->due += (dds_duration_t)(DDS_NSECS_IN_SEC / next->rate);
    message.data._buffer = calloc(next->size, 1);
    message.data._length = message.data._maximum = next->size;
    check(dds_write(next->endpoint, &message), "dds_write");
    free(message.data._buffer);
  }
}

static void receive(dds_entity_t participant, struct topic *topics, int count)
{
  dds_entity_t waitset = dds_create_waitset(participant);
  check(waitset, "dds_create_waitset");
  for (int i = 0; i < count; i++) {
    check(dds_set_status_mask(topics[i].endpoint, DDS_DATA_AVAILABLE_STATUS), "status mask");
    check(dds_waitset_attach(waitset, topics[i].endpoint, i), "dds_waitset_attach");
  }
  uint64_t received = 0;
  dds_time_t print = dds_time() + DDS_NSECS_IN_SEC;
  for (;;) {
    dds_attach_t ready[MOST];
    int n = dds_waitset_wait(waitset, ready, MOST, DDS_MSECS(200));
    check(n, "dds_waitset_wait");
    for (int i = 0; i < n && i < MOST; i++) {
      void *samples[16] = {NULL};
      dds_sample_info_t infos[16];
      dds_entity_t reader = topics[ready[i]].endpoint;
      int taken = dds_take(reader, samples, infos, 16, 16);
      check(taken, "dds_take");
      for (int k = 0; k < taken; k++)
        received += infos[k].valid_data;
      dds_return_loan(reader, samples, taken);
    }
    if (dds_time() >= print) {
      printf("received=%" PRIu64 " \n", received);
      fflush(stdout);
      print += DDS_NSECS_IN_SEC;
    }
  }
}

int main(int argc, char **argv)
{
  int count = (argc - 2) / 3;
  if (argc < 5 || (argc - 2) % 3 != 0 || count > MOST) {
    fprintf(stderr, "load source|sink RATE SIZE RELIABLE ...\n");
    return 2;
  }
  int source = strcmp(argv[1], "source") == 0;
  dds_entity_t participant = dds_create_participant(DDS_DOMAIN_DEFAULT, NULL, NULL);
  check(participant, "dds_create_participant");
  struct topic topics[MOST];
  for (int i = 0; i < count; i++) {
    char name[16], **of = argv + 2 + 3 * i;
    snprintf(name, sizeof name, "load%d", i);
    topics[i].rate = atof(of[0]);
    topics[i].size = (uint32_t)atoi(of[1]);
    dds_qos_t *qos = dds_create_qos();
    dds_qset_reliability(
      qos, atoi(of[2]) ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, DDS_MSECS(100));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
    dds_entity_t topic = dds_create_topic(participant, &Bytes_desc, name, qos, NULL);
    check(topic, "dds_create_topic");
    topics[i].endpoint = source ? dds_create_writer(participant, topic, qos, NULL)
                                : dds_create_reader(participant, topic, qos, NULL);
    check(topics[i].endpoint, "the endpoint");
    dds_delete_qos(qos);
  }
  if (source)
    publish(topics, count);
  else
    receive(participant, topics, count);
  return 0;
}
