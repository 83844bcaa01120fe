!> Many motions in lanes, eight at a time: of pendulums, or of polynomial systems without memory.
!! Systems with different numbers share lanes if they have the same form. A parameter may change the
!! form, as a factor of 0 removes a term.
module viscovib_lane_runs
  use viscovib_ensemble, only: blocks_of, check_method, ensemble_block, ensemble_job, run_block, &
    run_together
  use viscovib_kinds, only: wp
  use viscovib_lane_motion, only: lane_motion_type
  use viscovib_lanes, only: n_lanes
  use viscovib_load, only: load_type
  use viscovib_many_motions, only: many_motions
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: set_ok, status_type
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: lane_runs

  type, abstract :: lane_runs
    !> Pendulums with their own loads; else systems under a load. True if all systems are the same.
    logical :: of_pendulums = .false., one_system = .true.
    type(load_type), pointer :: load => null()
    !> Starts, a column for each motion.
    real(wp), allocatable :: starts(:, :)
    !> Frequency of the load, and scales of `viscovib_lane_motion`, of each motion.
    real(wp), allocatable :: frequencies(:), scales(:, :)
  contains
    procedure(pendulum_interface), deferred :: pendulum_of
    procedure(motion_interface), deferred :: motion_of
    procedure :: find_fastest
    procedure :: run_in_lanes
    procedure, private :: put
    procedure, private :: flush
  end type lane_runs

  !> Motions of one form that wait until their lanes are full.
  type :: waiting_type
    !> The systems of each block.
    type(lane_motion_type), allocatable :: motions(:)
    type(pendulum_type) :: pendulum
    integer :: n = 0
    integer, allocatable :: runs(:)
    !> Frequencies of the loads, a column for each motion.
    real(wp), allocatable :: drives(:, :)
  end type waiting_type

  abstract interface

    !> Pendulum i.
    subroutine pendulum_interface(self, i, pendulum, status)
      import :: lane_runs, pendulum_type, status_type
      class(lane_runs), intent(in) :: self
      integer, intent(in) :: i
      type(pendulum_type), intent(out) :: pendulum
      type(status_type), intent(out) :: status
    end subroutine pendulum_interface

    !> System i with its load, without scales.
    subroutine motion_interface(self, i, motion, status)
      import :: lane_motion_type, lane_runs, status_type
      class(lane_runs), intent(in) :: self
      integer, intent(in) :: i
      type(lane_motion_type), intent(out) :: motion
      type(status_type), intent(out) :: status
    end subroutine motion_interface

  end interface

contains

  !> Upper bound of the rates of each motion (rad/s), for the initial step size: of the linear
  !! subsystem and of the loads.
  subroutine find_fastest(self, fastest, status)
    class(lane_runs), intent(in) :: self
    real(wp), allocatable, intent(out) :: fastest(:)
    type(status_type), intent(out) :: status
    type(pendulum_type) :: pendulum
    type(lane_motion_type) :: motion
    real(wp) :: omega(3), shapes(3, 3)
    integer :: i

    call set_ok(status)
    allocate (fastest(size(self%starts, 2)))
    do i = 1, size(fastest)
      if (self%of_pendulums) then
        call self%pendulum_of(i, pendulum, status)
        if (status%failed()) return
        call pendulum%natural_modes(omega, shapes)
        fastest(i) = max(maxval(omega), maxval(pendulum%drives))
      else
        if (i == 1 .or. .not. self%one_system) call self%motion_of(i, motion, status)
        if (status%failed()) return
        fastest(i) = max(motion%fastest(self%scales(:, i)), &
                         self%frequencies(i)*maxval([0, motion%orders]))
      end if
    end do
  end subroutine find_fastest

  !> Compute all motions; another thread may set `cancel` to interrupt them. The last motion of a
  !! form is repeated in idle lanes.
  subroutine run_in_lanes(self, job, h, points, many, cancel, status)
    class(lane_runs), intent(in) :: self
    type(ensemble_job), intent(in) :: job
    !> Step size of each motion, and the number of points of its section.
    real(wp), intent(in) :: h(:)
    integer, intent(in) :: points
    type(many_motions), intent(inout) :: many
    integer, intent(inout) :: cancel
    type(status_type), intent(out) :: status
    type(waiting_type), allocatable :: waiting(:)
    integer :: i, j, k

    call set_ok(status)
    allocate (waiting(0))
    do i = 1, size(h)
      call self%put(i, job, waiting, k, status)
      if (status%failed()) return
      if (waiting(k)%n < size(waiting(k)%runs)) cycle
      call self%flush(job, h, points, waiting(k), many, cancel)
      if (is_set(cancel)) return
    end do
    do j = 1, size(waiting)
      do while (mod(waiting(j)%n, n_lanes) > 0)
        call self%put(waiting(j)%runs(waiting(j)%n), job, waiting, k, status)
        if (status%failed()) return
      end do
      if (waiting(j)%n > 0) call self%flush(job, h, points, waiting(j), many, cancel)
      if (is_set(cancel)) return
    end do
  end subroutine run_in_lanes

  !> Put the numbers of motion i into the next lane of its form.
  subroutine put(self, i, job, waiting, k, status)
    class(lane_runs), intent(in) :: self
    integer, intent(in) :: i
    type(ensemble_job), intent(in) :: job
    type(waiting_type), allocatable, intent(inout) :: waiting(:)
    !> Index of the form.
    integer, intent(out) :: k
    type(status_type), intent(out) :: status
    type(pendulum_type) :: pendulum
    type(lane_motion_type) :: motion
    logical :: has_motion
    integer :: b, l

    call set_ok(status)
    k = 1
    has_motion = .not. self%of_pendulums .and. (size(waiting) == 0 .or. .not. self%one_system)
    if (self%of_pendulums) call self%pendulum_of(i, pendulum, status)
    if (has_motion) call self%motion_of(i, motion, status)
    if (status%failed()) return
    if (has_motion) then
      do k = 1, size(waiting)
        if (waiting(k)%motions(1)%differs_in_numbers(motion)) exit
      end do
    end if
    if (k > size(waiting)) then
      call add_form(waiting, n_lanes*blocks_of(job))
      if (has_motion) then
        call check_method(job, motion, status)
        allocate (waiting(k)%motions(blocks_of(job)), source=motion)
        allocate (waiting(k)%drives(2, size(waiting(k)%runs)))
      else
        call check_method(job, pendulum, status)
        allocate (waiting(k)%drives(size(pendulum%drives), size(waiting(k)%runs)))
      end if
      if (status%failed()) return
    end if
    associate (its => waiting(k))
      b = its%n/n_lanes + 1
      l = its%n - n_lanes*(b - 1) + 1
      its%n = its%n + 1
      its%runs(its%n) = i
      if (self%of_pendulums) then
        if (l == 1) its%pendulum = pendulum
        call its%pendulum%set_lane(l, pendulum)
        its%drives(:, its%n) = pendulum%drives
        return
      end if
      its%drives(:, its%n) = self%frequencies(i)
      if (self%one_system) then
        call its%motions(b)%set_scales(l, self%scales(:, i), self%frequencies(i))
      else
        call motion%set_scales(1, self%scales(:, i), self%frequencies(i))
        call its%motions(b)%take_lane(l, motion)
      end if
    end associate
  end subroutine put

  !> Add a form, for some motions.
  subroutine add_form(waiting, n)
    type(waiting_type), allocatable, intent(inout) :: waiting(:)
    integer, intent(in) :: n
    type(waiting_type), allocatable :: more(:)
    integer :: i

    allocate (more(size(waiting) + 1))
    do i = 1, size(waiting)
      more(i) = waiting(i)
    end do
    allocate (more(size(more))%runs(n))
    call move_alloc(more, waiting)
  end subroutine add_form

  !> Compute the motions that wait, in full lanes.
  subroutine flush(self, job, h, points, waiting, many, cancel)
    class(lane_runs), intent(in) :: self
    type(ensemble_job), intent(in) :: job
    real(wp), intent(in) :: h(:)
    integer, intent(in) :: points
    type(waiting_type), intent(inout) :: waiting
    type(many_motions), intent(inout) :: many
    integer, intent(inout) :: cancel
    type(ensemble_block) :: blocks(waiting%n/n_lanes)
    integer :: b, first, l, last

    do b = 1, size(blocks)
      first = n_lanes*(b - 1) + 1
      last = n_lanes*b
      call blocks(b)%set_starts(waiting%runs(first:last), self%starts, h, &
                                size(waiting%drives, 1), points)
      blocks(b)%frequencies = transpose(waiting%drives(:, first:last))
    end do
    if (self%of_pendulums) then
      call run_block(job, waiting%pendulum, blocks(1), cancel)
    else if (blocks_of(job) > 1) then
      call run_together(job, waiting%motions(:size(blocks)), blocks, cancel)
    else
      call run_block(job, waiting%motions(1), blocks(1), cancel)
    end if
    do b = 1, size(blocks)
      do l = 1, n_lanes
        call many%take_lane(blocks(b), l, waiting%runs(n_lanes*(b - 1) + l))
      end do
    end do
    waiting%n = 0
  end subroutine flush

end module viscovib_lane_runs
