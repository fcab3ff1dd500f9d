/* A delegate library as libedgetpu is one, without a device: it computes y = max(x, 0) in float32 for
 * every edgetpu-custom-op. The structures are the public ones of TensorFlow Lite's C interface, up to
 * the last field that is used here; pointers to functions that are not called are left untyped. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct { int size; int data[]; } IntArray;
typedef struct { int type; float *data; IntArray *dims; struct { float scale; int32_t zero_point; } params;
                 int allocation; size_t bytes; const void *content; const char *name; void *delegate;
                 int buffer_handle; _Bool stale, variable; struct { int type; void *params; } quantization;
                 void *sparsity; const IntArray *signature; } Tensor;
typedef struct { IntArray *inputs, *outputs; } Node;
typedef struct Context Context;
typedef struct Delegate Delegate;
typedef struct { void *(*init)(Context *, const char *, size_t); void (*free)(Context *, void *);
                 int (*prepare)(Context *, Node *); int (*invoke)(Context *, Node *);
                 void *profiling_string; int32_t builtin_code; const char *custom_name; int version;
                 void *external, *async_kernel; uint64_t inplace_operator; } Registration;
struct Context {
  size_t tensors_size;
  int (*get_execution_plan)(Context *, IntArray **);
  Tensor *tensors;
  void *impl, *resize_tensor, *report_error, *add_tensors;
  int (*get_node_and_registration)(Context *, int, Node **, Registration **);
  int (*replace_node_subsets)(Context *, Registration, const IntArray *, Delegate *);
};
struct Delegate { void *data; int (*prepare)(Context *, Delegate *);
                  void *copy_from, *copy_to, *free_handle; int64_t flags; void *builder; };

static char options[256];
static int unplugged, alive;

static void *init(Context *context, const char *buffer, size_t length) { return NULL; }
static void release(Context *context, void *data) {}
static int ready(Context *context, Node *node) { return 0; }

static int relu(Context *context, Node *node) {
  if (unplugged) return 1;
  Tensor *x = &context->tensors[node->inputs->data[0]], *y = &context->tensors[node->outputs->data[0]];
  for (size_t i = 0; i < y->bytes / sizeof(float); i++) y->data[i] = x->data[i] > 0 ? x->data[i] : 0;
  return 0;
}

static int claim(Context *context, Delegate *delegate) {
  IntArray *plan;
  context->get_execution_plan(context, &plan);
  IntArray *mine = malloc(sizeof(IntArray) + plan->size * sizeof(int));
  mine->size = 0;
  for (int i = 0; i < plan->size; i++) {
    Node *node;
    Registration *kernel;
    context->get_node_and_registration(context, plan->data[i], &node, &kernel);
    if (kernel->custom_name && !strcmp(kernel->custom_name, "edgetpu-custom-op"))
      mine->data[mine->size++] = plan->data[i];
  }
  Registration kernel = {init, release, ready, relu, NULL, 0, "StubEdgeTpu", 1};
  int status = mine->size ? context->replace_node_subsets(context, kernel, mine, delegate) : 0;
  free(mine);
  return status;
}

Delegate *tflite_plugin_create_delegate(char **keys, char **values, size_t count, void (*report)(const char *)) {
  options[0] = 0;
  for (size_t i = 0; i < count; i++)
    snprintf(options + strlen(options), sizeof options - strlen(options), "%s=%s;", keys[i], values[i]);
  if (strstr(options, "usb:9")) return NULL;                              /* as libedgetpu: no word */
  if (strstr(options, "pci:9")) return report("stub: pci:9 is on fire"), NULL;
  Delegate *delegate = calloc(1, sizeof *delegate);
  delegate->prepare = claim;
  delegate->flags = 1; /* as libedgetpu: else the custom operators would be prepared before it is asked */
  alive++;
  return delegate;
}

void tflite_plugin_destroy_delegate(Delegate *delegate) {
  if (delegate) alive--;
  free(delegate);
}

const char *edgetpu_version(void) { return "stub 1.0"; }

/* What the tests ask and do beside libedgetpu's own interface. */
const char *stub_options(void) { return options; }
int stub_alive(void) { return alive; }
void stub_unplug(int pulled) { unplugged = pulled; }
