!> Motion with memory in equal steps: Gauss collocation of the accelerations, with
!! hereditary variables remembered as polynomials through the nodes and both ends.
!!
!! The equations of a step are in `hereditary_maps`; nonlinear parts are found by
!! iterating X = G z + Z y(X), which contracts like h^2 times the nonlinear
!! stiffness, and by Newton's method where that does not.
module viscovib_hereditary
  use viscovib_ancient, only: ancient_type, new_ancient
  use viscovib_channels, only: channels_type, new_channels
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_counters, only: count_up, counted_coordinates, counted_memory, counted_turns, &
    counting
  use viscovib_dense, only: factorize, solve
  use viscovib_direct_history, only: direct_history_type, new_direct_history
  use viscovib_exponential_history, only: exponential_history_type, new_exponential_history
  use viscovib_hereditary_kernels, only: add_columns, add_held, add_up, carry_on, compare, copy, &
    gather_channels, judge, product_of
  use viscovib_hereditary_maps, only: new_step_map, step_map_type
  use viscovib_hereditary_start, only: march_start, start_type
  use viscovib_history, only: history_type
  use viscovib_kinds, only: i8, wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_time_load, only: load_clock, new_clock, time_load_type
  implicit none
  private

  public :: hereditary_type, new_hereditary

  !> How the past is kept: as exponentials, or step by step.
  integer, parameter, public :: past_exponentials = 1, past_direct = 2
  !> Why no run can be made.
  integer, parameter, public :: begun = 0, no_exponentials = 1, step_too_large = 2, no_integral = 3

  integer, parameter :: max_iterations = 50
  !> Contraction beyond which Newton's method takes over, and turns before it is judged.
  real(wp), parameter :: slow = 0.25_wp
  integer, parameter :: patience = 2
  !> Change at which rounding is all that is left, relative to displacements.
  real(wp), parameter :: rounding = 1.0e-13_wp

  type :: hereditary_type
    real(wp) :: h = 0.0_wp
    !> State, shape (n_dof), and what rounding took from it.
    real(wp), allocatable :: u(:), v(:), u_rest(:), v_rest(:)
    integer :: n_iterations = 0
    !> Largest last Legendre coefficient of the displacements on a step, and largest
    !! displacement, shape (n_dof): together they tell how well steps resolve the motion.
    real(wp), allocatable :: roughness(:), largest(:)
    type(collocation_type) :: table
    type(step_map_type) :: map
    type(channels_type) :: channels
    class(history_type), allocatable :: history
    type(load_clock) :: clock
    type(start_type) :: start
    type(ancient_type) :: ancient
    !> Solution counts as found at this change, relative to displacements.
    real(wp) :: solved = rounding
    !> Displacements at the points of the last step, shape (0:s+1, n_dof).
    real(wp), allocatable :: points(:, :)
    !> Nonlinear inputs of the last step: hereditary variables at its start, shape
    !! (n_bent), and what `from_bend` takes.
    real(wp), allocatable, private :: y_start(:), y(:)
    !> What carries these on to the next step: from the start and from the other
    !! points; of force remainders from nodes.
    real(wp), allocatable, private :: onward_start(:), onward(:, :), onward_nodes(:, :)
    !> T W, shape (n_channels, n_dof), and T of the bent variables.
    real(wp), allocatable, private :: gather(:, :), gather_bends(:, :)
    !> Room for a step: inputs, linear part, X, its next value, channels at the points,
    !! displacements and hereditary variables at the points.
    real(wp), allocatable, private :: z(:), linear(:), x(:), next(:), g(:, :), u_points(:, :), &
                                      w_points(:, :)
    !> The next step follows one of its own kind.
    logical, private :: rolling = .false.
  contains
    procedure :: step
    procedure :: inside
    procedure :: resolution
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
    procedure, private :: iterate
    procedure, private :: evaluate_bends
    procedure, private :: evaluate_remainders
    procedure, private :: newton_step
    procedure, private :: predict
    procedure, private :: add_first_step
  end type hereditary_type

contains

  !> A run from (u, v) at time 0. `reason`: `begun`, or why it is not.
  subroutine new_hereditary(run, system, load, s, past, held, u, v, h, t_end, tolerance, reason, &
                            before, moved)
    type(hereditary_type), intent(out) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Nodes of a step; `past_exponentials` or `past_direct`.
    integer, intent(in) :: s, past
    !> Displacement held for all t < 0, shape (n_dof): what is remembered.
    real(wp), intent(in) :: held(:)
    !> Start, shape (n_dof); step; latest time; relative error of the kernels as
    !! exponentials and of a step's solution.
    real(wp), intent(in) :: u(:), v(:), h, t_end, tolerance
    integer, intent(out) :: reason
    !> Times ascending to 0 and displacements there, shapes (n) and (n_dof, n), if the
    !! motion before 0 is known; `held` is the first of them then.
    real(wp), intent(in), optional :: before(:), moved(:, :)
    type(exponential_history_type), allocatable :: exponentials
    type(direct_history_type), allocatable :: direct
    real(wp) :: basis(0:s + 1)
    logical :: possible, singular
    integer :: j

    reason = begun
    run%h = h
    run%u = u
    run%v = v
    run%u_rest = 0.0_wp*u
    run%roughness = 0.0_wp*u
    run%largest = 0.0_wp*u
    run%v_rest = 0.0_wp*v
    run%solved = max(1.0e-2_wp*tolerance, epsilon(1.0_wp))
    call new_collocation(run%table, s)
    if (any(abs(held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      reason = no_integral
      return
    end if
    call new_channels(run%channels, system, held)
    call new_step_map(run%map, system, run%channels, run%table, h, singular)
    if (singular) then
      reason = step_too_large
      return
    end if
    if (past == past_exponentials) then
      allocate (exponentials)
      call new_exponential_history(exponentials, system, run%channels, run%table, h, t_end, &
                                   max(tolerance, 1.0e-14_wp), possible)
      if (.not. possible) then
        reason = no_exponentials
        return
      end if
      call move_alloc(exponentials, run%history)
    else
      allocate (direct)
      call new_direct_history(direct, system, run%channels, run%table, h)
      call move_alloc(direct, run%history)
    end if
    if (present(before) .and. run%map%n_channels > 0) then
      call new_ancient(run%ancient, system, run%channels, before, moved)
      if (run%ancient%is_known()) call run%history%add_ancient(run%ancient)
    end if
    call new_clock(run%clock, load, 0.0_wp, h, run%table%points(1:s))
    run%gather = matmul(run%channels%gather, system%gather)
    run%gather_bends = run%channels%gather(:, run%map%bent)
    allocate (run%points(0:s + 1, size(u)), run%g(0:s + 1, run%map%n_channels))
    allocate (run%y_start(size(run%map%bent)), run%y(size(run%map%from_bend, 2)))
    allocate (run%z(size(run%map%from_input, 2)), run%linear(size(run%map%from_input, 1)))
    allocate (run%x, run%next, mold=run%linear)
    allocate (run%u_points(s + 1, size(u)), run%w_points(s + 1, run%map%n_memory))
    run%points = 0.0_wp
    run%y = 0.0_wp
    run%w_points = 0.0_wp
    allocate (run%onward_start(s + 1), run%onward(s + 1, s + 1), run%onward_nodes(s, s))
    do j = 1, s + 1
      basis = run%table%basis(1.0_wp + run%table%points(j))
      run%onward_start(j) = basis(0)
      run%onward(j, :) = basis(1:)
    end do
    call node_extrapolation(run%table, run%onward_nodes)
    call start_bends(run, system)
  end subroutine new_hereditary

  !> From values at the nodes of one step to those at the nodes of the next.
  subroutine node_extrapolation(table, onward)
    use viscovib_quadrature, only: lagrange, lagrange_factors
    type(collocation_type), intent(in) :: table
    real(wp), intent(out) :: onward(:, :)
    real(wp) :: c(table%s), factors(table%s)
    integer :: i
    c = table%points(1:table%s)
    factors = lagrange_factors(c)
    do i = 1, table%s
      onward(i, :) = lagrange(c, factors, 1.0_wp + c(i))
    end do
  end subroutine node_extrapolation

  !> Nonlinear part at the present state, as the start of the next step.
  subroutine start_bends(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp) :: u(1, size(self%u)), w(1, system%n_memory())
    integer :: b

    u(1, :) = self%u
    w = 0.0_wp
    if (size(self%map%bent) > 0) call system%deflection_remainder(u, w)
    do b = 1, size(self%map%bent)
      self%y(b*(self%table%s + 1)) = w(1, self%map%bent(b))
    end do
    self%points(self%table%s + 1, :) = self%u
    self%rolling = .false.
  end subroutine start_bends

  !> One step; `made` is false, and the state stays, if its equations do not settle.
  subroutine step(self, system, load, n_before, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Steps made before.
    integer(i8), intent(in) :: n_before
    logical, intent(out) :: made
    integer :: d, n, s

    s = self%map%s
    n = self%map%n_dof
    if (n_before == 0) then
      call self%add_first_step(system, load, made)
      if (made) return
    end if
    if (counting) call count_up(counted_coordinates, n)
    self%z(:n) = self%u
    self%z(n + 1:2*n) = self%v
    call self%clock%at_nodes(load, self%z(self%map%at_load + 1:self%map%at_memory))
    if (self%map%n_channels > 0) then
      call self%history%recall(self%z(self%map%at_memory + 1:self%map%at_bend))
      call add_held(s*self%map%n_channels, self%map%held, &
                    self%z(self%map%at_memory + 1:self%map%at_bend))
    end if
    call self%predict()
    self%z(self%map%at_bend + 1:) = self%y_start
    call self%iterate(system, made)
    if (.not. made) return
    do d = 1, n
      self%points(0, d) = self%u(d)
      self%points(1:, d) = self%u(d) + self%x((d - 1)*(s + 1) + 1:d*(s + 1))
      call judge(s + 2, self%points(:, d), self%table%last_coefficient, self%roughness(d), &
                 self%largest(d))
      call add_up(self%u(d), self%u_rest(d), self%x(d*(s + 1)))
      call add_up(self%v(d), self%v_rest(d), self%x(self%map%velocity_row + d - 1))
    end do
    if (self%map%n_channels > 0) then
      call gather_channels(s + 2, n, size(self%y_start), self%map%n_channels, self%points, &
                           self%y_start, self%y, self%gather, self%gather_bends, &
                           self%channels%held, self%g)
      if (counting) call count_up(counted_memory, self%map%n_channels)
      call self%history%store(self%g)
    end if
    call self%clock%advance((n_before + 1)*self%h)
    self%rolling = .true.
  end subroutine step

  !> Largest last Legendre coefficient of a displacement, relative to its largest value.
  pure real(wp) function resolution(self)
    class(hereditary_type), intent(in) :: self
    integer :: d
    resolution = 0.0_wp
    do d = 1, size(self%largest)
      if (self%largest(d) > 0.0_wp) resolution = max(resolution, &
                                                     self%roughness(d)/self%largest(d))
    end do
  end function resolution

  !> The first step as a sequence of panels, where memory makes the start singular;
  !! `made` is false where a plain step will do.
  subroutine add_first_step(self, system, load, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    logical, intent(out) :: made
    real(wp) :: f(size(self%u))

    made = .false.
    if (self%map%n_channels == 0) return
    call load%at(0.0_wp, f)
    if (.not. (any(abs(self%u) > 0.0_wp) .or. any(abs(self%v) > 0.0_wp) &
               .or. any(abs(f) > 0.0_wp) .or. self%ancient%is_known())) return
    call march_start(self%start, system, self%channels, load, self%ancient, self%h, self%u, &
                     self%v, made)
    if (.not. made) return
    call self%history%begin(self%start%table, self%start%past)
    call self%clock%advance(self%h)
    call start_bends(self, system)
  end subroutine add_first_step

  !> Nonlinear parts at the points of the next step by those of the last.
  subroutine predict(self)
    class(hereditary_type), intent(inout) :: self
    integer :: b, n, s

    s = self%table%s
    do b = 1, size(self%y_start)
      associate (part => self%y((b - 1)*(s + 1) + 1:b*(s + 1)))
        if (self%rolling) then
          call carry_on(s + 1, self%onward_start, self%onward, self%y_start(b), part)
        else
          self%y_start(b) = part(s + 1)
          part = part(s + 1)
        end if
      end associate
    end do
    if (self%map%separable .or. .not. self%rolling) return
    n = self%map%at_remainder
    do b = 1, self%map%n_dof
      self%y(n + 1:n + s) = matmul(self%onward_nodes, self%y(n + 1:n + s))
      n = n + s
    end do
  end subroutine predict

  !> X = G z + Z y(X), from the predicted y on.
  subroutine iterate(self, system, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    logical, intent(out) :: made
    real(wp) :: change, before, size_of
    integer :: turn, n_rows, n_y
    logical :: newton

    n_rows = size(self%x)
    n_y = size(self%y)
    call product_of(n_rows, size(self%z), self%map%from_input, self%z, self%linear)
    if (n_y == 0) then
      self%x = self%linear
      made = all(abs(self%x) <= huge(1.0_wp))
      return
    end if
    call product_of(n_rows, n_y, self%map%from_bend, self%y, self%x)
    self%x = self%linear + self%x
    newton = .false.
    before = huge(1.0_wp)
    do turn = 1, max_iterations
      self%n_iterations = self%n_iterations + 1
      if (counting) call count_up(counted_turns, 1)
      call self%evaluate_bends(system)
      call product_of(n_rows, n_y, self%map%from_bend, self%y, self%next)
      self%next = self%linear + self%next
      if (newton) then
        call self%newton_step(system, made)
        if (.not. made) return
      end if
      call compare(self%map%n_core, self%x, self%next, change, size_of)
      size_of = size_of + maxval(abs(self%u))
      self%x = self%next
      made = change <= self%solved*size_of &
             .or. (change >= 0.5_wp*before .and. change <= rounding*size_of)
      if (made .or. .not. change <= huge(1.0_wp)) return
      if (turn >= patience .and. change > slow*before) newton = .true.
      before = change
    end do
  end subroutine iterate

  !> y(X), and the displacements it is at.
  subroutine evaluate_bends(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer :: b, s

    s = self%map%s
    call add_columns(s + 1, self%map%n_dof, self%u, self%x, self%u_points)
    if (size(self%map%bent) > 0) call system%deflection_remainder(self%u_points, self%w_points)
    do b = 1, size(self%map%bent)
      call copy(s + 1, self%w_points(:, self%map%bent(b)), self%y((b - 1)*(s + 1) + 1:b*(s + 1)))
    end do
    if (.not. self%map%separable) call self%evaluate_remainders(system)
  end subroutine evaluate_bends

  !> r(u, v) at the nodes.
  subroutine evaluate_remainders(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp) :: inner(self%map%s, self%map%n_dof), variables(self%map%s, self%map%n_memory)
    real(wp) :: force(self%map%s, self%map%n_dof)
    integer :: first

    first = self%map%variable_row
    inner = self%u_points(:self%map%s, :)
    variables = reshape(self%x(first:first + size(variables) - 1), shape(variables))
    call system%force_remainder(inner, variables, force)
    self%y(self%map%at_remainder + 1:) = reshape(force, [size(force)])
  end subroutine evaluate_remainders

  !> Newton's next X: x + (1 - Z S)^-1 (next - x), S the slopes of y.
  subroutine newton_step(self, system, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    logical, intent(out) :: made
    real(wp) :: slopes(self%map%s + 1, self%map%n_memory, self%map%n_dof)
    real(wp) :: inner(self%map%s, self%map%n_dof), variables(self%map%s, self%map%n_memory)
    real(wp) :: by_u(self%map%s, self%map%n_dof, self%map%n_dof)
    real(wp) :: by_v(self%map%s, self%map%n_dof, self%map%n_memory)
    real(wp) :: matrix(size(self%x), size(self%x)), shift(size(self%x))
    integer :: pivots(size(self%x)), a, b, i, j, n, s, row, column, first
    logical :: singular

    s = self%map%s
    n = size(self%x)
    matrix = 0.0_wp
    do i = 1, n
      matrix(i, i) = 1.0_wp
    end do
    if (size(self%map%bent) > 0) call system%deflection_slopes(self%u_points, slopes)
    do b = 1, self%map%n_dof
      do j = 1, size(self%map%bent)
        do i = 1, s + 1
          row = (b - 1)*(s + 1) + i
          column = (j - 1)*(s + 1) + i
          matrix(:, row) = matrix(:, row) &
                           - self%map%from_bend(:, column)*slopes(i, self%map%bent(j), b)
        end do
      end do
    end do
    if (.not. self%map%separable) then
      first = self%map%variable_row
      inner = self%u_points(:s, :)
      variables = reshape(self%x(first:first + size(variables) - 1), shape(variables))
      call system%force_slopes(inner, variables, by_u, by_v)
      do a = 1, self%map%n_dof
        do i = 1, s
          column = self%map%at_remainder + (a - 1)*s + i
          do b = 1, self%map%n_dof
            row = (b - 1)*(s + 1) + i
            matrix(:, row) = matrix(:, row) - self%map%from_bend(:, column)*by_u(i, a, b)
          end do
          do j = 1, self%map%n_memory
            row = first + (j - 1)*s + i - 1
            matrix(:, row) = matrix(:, row) - self%map%from_bend(:, column)*by_v(i, a, j)
          end do
        end do
      end do
    end if
    shift = self%next - self%x
    call factorize(n, matrix, pivots, singular)
    made = .not. singular
    if (singular) return
    call solve(n, matrix, pivots, shift)
    self%next = self%x + shift
  end subroutine newton_step

  !> State a fraction of a step back from its end, by the polynomial of the step.
  subroutine inside(self, theta, u, v)
    class(hereditary_type), intent(in) :: self
    !> In [0, 1], 1 at the end of the last step.
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: u(:), v(:)
    if (self%rolling .or. .not. allocated(self%start%ends)) then
      u = matmul(self%table%basis(theta), self%points)
      v = matmul(self%table%slopes(theta), self%points)/self%h
    else
      call self%start%at(theta*self%h, u, v)
    end if
  end subroutine inside

  pure integer function memory_size(self)
    class(hereditary_type), intent(in) :: self
    memory_size = 2 + 4*size(self%u) + size(self%y_start) + size(self%y) + 2*size(self%clock%high)
    if (self%map%n_channels > 0) memory_size = memory_size + self%history%memory_size()
  end function memory_size

  function save_memory(self) result(memory)
    class(hereditary_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    integer :: n

    n = 0
    call push([merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t])
    call push([self%u, self%v, self%u_rest, self%v_rest, self%y_start, self%y])
    call push([self%clock%high, self%clock%low])
    if (self%map%n_channels > 0) call push(self%history%save_memory())

  contains

    subroutine push(part)
      real(wp), intent(in) :: part(:)
      memory(n + 1:n + size(part)) = part
      n = n + size(part)
    end subroutine push

  end function save_memory

  subroutine load_memory(self, memory)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: n

    self%rolling = memory(1) > 0.5_wp
    self%clock%t = memory(2)
    n = 2
    call pull(self%u)
    call pull(self%v)
    call pull(self%u_rest)
    call pull(self%v_rest)
    call pull(self%y_start)
    call pull(self%y)
    call pull(self%clock%high)
    call pull(self%clock%low)
    if (self%map%n_channels > 0) call self%history%load_memory(memory(n + 1:))

  contains

    subroutine pull(part)
      real(wp), intent(out) :: part(:)
      part = memory(n + 1:n + size(part))
      n = n + size(part)
    end subroutine pull

  end subroutine load_memory

end module viscovib_hereditary
