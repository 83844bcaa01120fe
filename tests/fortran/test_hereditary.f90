!> Motion with memory: quadrature, sums of exponentials, and runs against values
!! of independent programs (data/mount_memory_reference.json).
module test_hereditary
  use testing, only: begin, check, check_close, check_ok
  use viscovib_base_motion, only: base_motion_type
  use viscovib_hereditary, only: hereditary_type, new_hereditary
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_histories, only: past_direct, past_exponentials, past_request
  use viscovib_kernel, only: kernel_type
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_march, only: begun, no_exponentials, no_integral
  use viscovib_mount, only: geometry_cubic, geometry_exact, mount_parameters, mount_type, new_mount
  use viscovib_prony, only: new_prony, prony_kernel
  use viscovib_gauss_points, only: points_16, points_32, points_8, weights_16, weights_32, weights_8
  use viscovib_quadrature, only: gauss_nodes, gauss_power_nodes, nodes_of_recurrence, recurrence_of
  use viscovib_rabotnov, only: new_rabotnov, rabotnov_kernel
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: status_type
  use viscovib_tabulated, only: interpolation_linear, new_tabulated, tabulated_kernel
  use viscovib_time_load, only: time_load_type
  use viscovib_time_run, only: run_completed, time_run
  implicit none
  private

  public :: run_hereditary_suite

contains

  subroutine run_hereditary_suite()
    if (begin('quadrature with a power weight')) call power_weight()
    if (begin('tabulated Gauss rules')) call tabulated_rules()
    if (begin('Gauss rule of a discrete measure')) call discrete_measure()
    if (begin('local rules integrate the kernel')) call local_integrals()
    if (begin('short sums of exponentials')) call short_sums()
    if (begin('forced from rest')) call forced()
    if (begin('free from a deflection')) call free()
    if (begin('exact geometry both ways')) call exact_geometry()
    if (begin('no memory')) call no_memory()
    if (begin('a run that cannot be made')) call refusals()
    if (begin('a run goes on bit for bit')) call goes_on()
  end subroutine run_hereditary_suite

  !> integral x^(alpha-1+k) = 1/(alpha+k) up to degree 2n-1.
  subroutine power_weight()
    real(wp), parameter :: alphas(4) = [0.01_wp, 0.1_wp, 0.5_wp, 1.0_wp]
    real(wp) :: x(12), w(12)
    integer :: i, k
    do i = 1, size(alphas)
      call gauss_power_nodes(12, alphas(i), x, w)
      do k = 0, 23
        call check_close(sum(w*x**k), 1.0_wp/(alphas(i) + k), 2.0e-14_wp, 'moment')
      end do
    end do
  end subroutine power_weight

  subroutine tabulated_rules()
    real(wp) :: x(32), w(32)
    call gauss_nodes(32, x, w)
    call check(maxval(abs(x - points_32)) < 4.0e-16_wp, '32 nodes')
    call check(maxval(abs(w - weights_32)) < 1.0e-15_wp, '32 weights')
    call gauss_nodes(16, x(:16), w(:16))
    call check(maxval(abs(x(:16) - points_16)) < 4.0e-16_wp, '16 nodes')
    call check(maxval(abs(w(:16) - weights_16)) < 1.0e-15_wp, '16 weights')
    call gauss_nodes(8, x(:8), w(:8))
    call check(maxval(abs(x(:8) - points_8)) < 4.0e-16_wp, '8 nodes')
    call check(maxval(abs(w(:8) - weights_8)) < 1.0e-15_wp, '8 weights')
  end subroutine tabulated_rules

  !> The rule has the moments of the measure up to degree 2n-1.
  subroutine discrete_measure()
    real(wp) :: points(150), masses(150), diagonal(10), nearby(10), x(10), w(10)
    integer :: k, found
    points = [(exp(-0.4_wp*k), k=0, 149)]
    masses = [(exp(-0.3_wp*k), k=0, 149)]
    call recurrence_of(points, masses, 10, diagonal, nearby, found)
    call nodes_of_recurrence(found, diagonal, nearby, x, w)
    do k = 0, 19
      call check_close(sum(w*x**k)*sum(masses), sum(masses*points**k), 1.0e-13_wp, 'moment')
    end do
    call recurrence_of([1.0_wp, 2.0_wp], [1.0_wp, 1.0_wp], 10, diagonal, nearby, found)
    call check(found == 2, 'two points have two polynomials')
  end subroutine discrete_measure

  !> From 0 to far beyond the decay of the kernel: its integral. For exp(-t) times R: the
  !! difference of two sums of the rule (Rzhanitsyn with beta + 1).
  subroutine local_integrals()
    class(kernel_type), allocatable :: kernel
    type(rzhanitsyn_kernel) :: rzhanitsyn
    type(rabotnov_kernel) :: rabotnov
    type(prony_kernel) :: prony
    type(tabulated_kernel) :: tabulated
    type(status_type) :: status

    call new_rzhanitsyn(rzhanitsyn, 0.7_wp, 0.05_wp, 3.0_wp, status)
    allocate (kernel, source=rzhanitsyn)
    call compare(20.0_wp, 1.0e-14_wp, 'rzhanitsyn')
    ! With alpha = 1 and z = beta t: A (1 - exp(-z))/beta.
    call new_rabotnov(rabotnov, 0.7_wp, 1.0_wp, 3.0_wp, status)
    deallocate (kernel)
    allocate (kernel, source=rabotnov)
    call compare(15.0_wp, 1.0e-13_wp, 'rabotnov')
    call new_prony(prony, [0.5_wp, 2.0_wp], [1.0_wp, 1000.0_wp], status)
    deallocate (kernel)
    allocate (kernel, source=prony)
    call compare(40.0_wp, 1.0e-14_wp, 'prony')
    call new_tabulated(tabulated, [0.0_wp, 1.0_wp, 3.0_wp], [2.0_wp, 1.0_wp, 0.2_wp], &
                       interpolation_linear, status)
    deallocate (kernel)
    allocate (kernel, source=tabulated)
    call compare(5.0_wp, 1.0e-14_wp, 'tabulated')

  contains

    subroutine compare(tau, tolerance, name)
      real(wp), intent(in) :: tau, tolerance
      character(len=*), intent(in) :: name
      real(wp), allocatable :: nodes(:, :), weights(:, :), x(:), w(:)
      call check_ok(status)
      call kernel%local_rules([tau, 0.3_wp*tau], nodes, weights)
      call check_close(sum(weights(:, 1)), kernel%integral(), tolerance, name)
      ! A rule from 0 to a point and a rule from this point give the whole integral.
      call kernel%lag_rule(0.3_wp*tau, tau, x, w)
      call check_close(sum(weights(:, 2)*nodes(:, 2)) + sum(w*x), sum(weights(:, 1)*nodes(:, 1)), &
                       tolerance, name//' in two pieces')
    end subroutine compare

  end subroutine local_integrals

  subroutine short_sums()
    type(rzhanitsyn_kernel) :: kernel
    type(rabotnov_kernel) :: rabotnov
    type(status_type) :: status
    real(wp), parameter :: tolerances(3) = [1.0e-6_wp, 1.0e-10_wp, 1.0e-13_wp]
    ! Upper bounds, 10 % above the smallest known numbers 34, 52 and 66.
    integer, parameter :: most(3) = [38, 59, 75]
    real(wp), allocatable :: weights(:), rates(:)
    integer :: i

    call new_rzhanitsyn(kernel, 1.0_wp, 0.1_wp, 0.0_wp, status)
    do i = 1, 3
      call kernel%exponentials(tolerances(i), 1.0e-4_wp, 1.0e4_wp, weights, rates)
      call check(size(weights) <= most(i), 'number of terms')
      call check(all(weights > 0.0_wp) .and. all(rates >= 0.0_wp), 'positive')
      call check(error_of(kernel) <= max(tolerances(i), 2.0e-14_wp), 'error')
    end do
    call new_rabotnov(rabotnov, 1.0_wp, 0.6_wp, 0.5_wp, status)
    call rabotnov%exponentials(1.0e-9_wp, 1.0e-3_wp, 1.0e3_wp, weights, rates)
    call check(error_of(rabotnov) <= 1.0e-9_wp, 'error of rabotnov')

  contains

    real(wp) function error_of(k)
      class(kernel_type), intent(in) :: k
      real(wp) :: t(1), exact(1), near
      integer :: j
      error_of = 0.0_wp
      do j = 0, 400
        t = 1.0e-3_wp*10.0_wp**(j*6.0_wp/400)
        call k%value(t, exact)
        near = sum(weights*exp(-min(rates*t(1), 700.0_wp)))
        error_of = max(error_of, abs(near/exact(1) - 1.0_wp))
      end do
    end function error_of

  end subroutine short_sums

  subroutine build(mount, geometry, memory)
    type(mount_type), intent(out) :: mount
    integer, intent(in) :: geometry
    logical, intent(in) :: memory
    type(mount_parameters) :: parameters
    type(rzhanitsyn_kernel) :: kernel
    type(kernel_holder) :: kernels(1)
    type(status_type) :: status

    call new_rzhanitsyn(kernel, 0.048_wp, 0.1_wp, 0.05_wp, status)
    allocate (kernels(1)%kernel, source=kernel)
    parameters%mass = 1.0_wp
    parameters%inertia = 0.1_wp
    parameters%offset = 0.5_wp
    parameters%stiffness_x = 10.0_wp
    parameters%stiffness_phi = 2.0_wp
    parameters%geometry = geometry
    if (memory) then
      parameters%kernel_x = 1
      parameters%kernel_phi = 1
    end if
    call new_mount(mount, parameters, kernels, status)
    call check_ok(status)
  end subroutine build

  pure function sine_load(size_of) result(load)
    real(wp), intent(in) :: size_of
    type(time_load_type) :: load
    allocate (load%frequencies(1), load%amplitudes(2, 1), load%breaks(0), load%pieces(2, 4, 0))
    load%frequencies(1) = 1.5_wp
    load%amplitudes(1, 1) = cmplx(size_of, 0.0_wp, wp)
    load%amplitudes(2, 1) = (0.0_wp, 0.0_wp)
  end function sine_load

  pure type(past_request) function request(s, past, held, h, t_end)
    integer, intent(in) :: s, past
    real(wp), intent(in) :: held, h, t_end
    request%nodes = s
    request%past = past
    allocate (request%held, source=[held, held])
    request%h = h
    request%t_end = t_end
    request%tolerance = 1.0e-13_wp
  end function request

  subroutine run_to(mount, load, s, past, start, t_end, n, last)
    type(mount_type), intent(in), target :: mount
    type(time_load_type), intent(in) :: load
    integer, intent(in) :: s, past, n
    real(wp), intent(in) :: start(4), t_end
    real(wp), intent(out) :: last(4)
    type(hereditary_type) :: run
    type(base_motion_type) :: base
    type(time_run) :: steps
    real(wp) :: thinnest
    integer :: reason

    call new_hereditary(run, mount, load, request(s, past, 0.0_wp, t_end/n, t_end), start(1::2), &
                        start(2::2), reason)
    call check(reason == begun, 'begun')
    steps%n_steps = n
    call steps%allocate_states(4, 0, t_end/n)
    call run_hereditary(run, base, steps, .false., thinnest)
    call check(steps%ended == run_completed .and. steps%n_done == n, 'completed')
    last(1::2) = run%u
    last(2::2) = run%v
  end subroutine run_to

  subroutine forced()
    type(mount_type) :: mount
    real(wp) :: last(4), coarse, fine
    real(wp), parameter :: exact(2) = [8.706100051384379e-01_wp, 9.234816022517897e-01_wp]

    call build(mount, geometry_cubic, .true.)
    call run_to(mount, sine_load(0.5_wp), 8, past_exponentials, [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
                10.0_wp, 60, last)
    call check_close(last(1), exact(1), 1.0e-12_wp, 'x')
    call check_close(last(3), exact(2), 1.0e-12_wp, 'phi')
    call run_to(mount, sine_load(0.5_wp), 4, past_direct, [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
                10.0_wp, 20, last)
    coarse = maxval(abs(last(1::2) - exact))
    call run_to(mount, sine_load(0.5_wp), 4, past_direct, [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], &
                10.0_wp, 80, last)
    fine = maxval(abs(last(1::2) - exact))
    call check(fine < coarse/4.0_wp**6, 'order above 6')
  end subroutine forced

  subroutine free()
    type(mount_type) :: mount
    real(wp) :: last(4)
    call build(mount, geometry_cubic, .true.)
    call run_to(mount, sine_load(0.0_wp), 8, past_exponentials, &
                [0.1_wp, 0.0_wp, 0.05_wp, 0.0_wp], 10.0_wp, 60, last)
    call check_close(last(1), -2.686512919324825e-02_wp, 1.0e-12_wp, 'x')
    call check_close(last(3), -3.713646537410475e-02_wp, 1.0e-12_wp, 'phi')
    call run_to(mount, sine_load(0.0_wp), 8, past_direct, [0.1_wp, 0.0_wp, 0.05_wp, 0.0_wp], &
                1.0_wp, 8, last)
    call check_close(last(1), 1.111829621206941e-02_wp, 5.0e-12_wp, 'x')
  end subroutine free

  subroutine exact_geometry()
    type(mount_type) :: mount
    real(wp) :: last(4), other(4)
    call build(mount, geometry_exact, .true.)
    call run_to(mount, sine_load(0.5_wp), 8, past_exponentials, &
                [0.1_wp, 0.2_wp, 0.05_wp, 0.0_wp], 5.0_wp, 30, last)
    call run_to(mount, sine_load(0.5_wp), 6, past_direct, [0.1_wp, 0.2_wp, 0.05_wp, 0.0_wp], &
                5.0_wp, 200, other)
    call check(maxval(abs(last - other)) < 1.0e-11_wp, 'both ways')
  end subroutine exact_geometry

  !> Energy of the cubic system, constant without memory and load.
  subroutine no_memory()
    type(mount_type) :: mount
    real(wp) :: last(4), start(4)
    call build(mount, geometry_cubic, .false.)
    start = [0.3_wp, 0.1_wp, -0.4_wp, 0.2_wp]
    call run_to(mount, sine_load(0.0_wp), 8, past_exponentials, start, 50.0_wp, 400, last)
    call check_close(energy(last), energy(start), 1.0e-12_wp, 'energy')

  contains

    pure real(wp) function energy(state)
      real(wp), intent(in) :: state(4)
      real(wp), parameter :: l = 0.5_wp
      ! c_x/2 (x - l sin phi)^2 to fourth order and c_phi/2 phi^2.
      associate (x => state(1), p => state(3))
        energy = 0.5_wp*(state(2)**2 + 0.1_wp*state(4)**2) + p**2 &
                 + 5.0_wp*((x - l*p)**2 + l*x*p**3/3.0_wp - l**2*p**4/3.0_wp)
      end associate
    end function energy

  end subroutine no_memory

  subroutine refusals()
    type(mount_type), target :: mount
    type(mount_parameters) :: parameters
    type(tabulated_kernel) :: table
    type(rzhanitsyn_kernel) :: abel
    type(kernel_holder) :: kernels(1)
    type(hereditary_type) :: run
    type(status_type) :: status
    real(wp) :: zero(2)
    integer :: reason

    zero = 0.0_wp
    parameters = mount_parameters(1.0_wp, 1.0_wp, 0.5_wp, 1.0_wp, 1.0_wp)
    parameters%kernel_x = 1
    call new_tabulated(table, [0.0_wp, 1.0_wp], [0.1_wp, 0.0_wp], interpolation_linear, status)
    allocate (kernels(1)%kernel, source=table)
    call new_mount(mount, parameters, kernels, status)
    call new_hereditary(run, mount, sine_load(1.0_wp), &
                        request(4, past_exponentials, 0.0_wp, 0.1_wp, 1.0_wp), zero, zero, reason)
    call check(reason == no_exponentials, 'a table is no sum of exponentials')
    call new_rzhanitsyn(abel, 0.1_wp, 0.5_wp, 0.0_wp, status)
    deallocate (kernels(1)%kernel)
    allocate (kernels(1)%kernel, source=abel)
    call new_mount(mount, parameters, kernels, status)
    call new_hereditary(run, mount, sine_load(1.0_wp), &
                        request(4, past_exponentials, 1.0_wp, 0.1_wp, 1.0_wp), zero, zero, reason)
    call check(reason == no_integral, 'a kernel without integral forgets what was held')
  end subroutine refusals

  subroutine goes_on()
    type(mount_type), target :: mount
    type(hereditary_type) :: whole, first, second
    real(wp), allocatable :: memory(:)
    integer :: past, i, reason
    logical :: made

    do past = past_exponentials, past_direct
      call build(mount, geometry_exact, .true.)
      call new_hereditary(whole, mount, sine_load(0.5_wp), &
                          request(4, past, 0.0_wp, 0.1_wp, 2.0_wp), [0.1_wp, 0.0_wp], &
                          [0.0_wp, 0.0_wp], reason)
      first = whole
      do i = 1, 20
        call whole%step(i*whole%h, made)
      end do
      do i = 1, 7
        call first%step(i*first%h, made)
      end do
      memory = first%save_memory()
      call new_hereditary(second, mount, sine_load(0.5_wp), &
                          request(4, past, 0.0_wp, 0.1_wp, 2.0_wp), [0.0_wp, 0.0_wp], &
                          [0.0_wp, 0.0_wp], reason)
      call second%load_memory(memory, .false.)
      do i = 8, 20
        call second%step(i*second%h, made)
      end do
      call check(all(second%u == whole%u) .and. all(second%v == whole%v), 'bit for bit')
    end do
  end subroutine goes_on

end module test_hereditary
