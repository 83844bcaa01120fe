! Optimize: -O1
!> Undamped modes about static equilibrium, without memory: K r = omega^2 M r, K = B W.
module viscovib_oscillator_modes
  use viscovib_dense, only: factorize, solve
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: oscillator_modes, least_loss

  !> Asymmetry, imaginary parts and negative values up to these fractions of the largest entry count
  !! as rounding errors.
  real(wp), parameter :: asymmetric = 1.0e-12_wp, complex_part = 1.0e-9_wp, &
                         negative = 1.0e-12_wp

contains

  !> All modes. If K is not symmetric (follower forces), the modes of M^-1 K, which must be real.
  subroutine oscillator_modes(system, omega, shapes, status)
    class(oscillator_type), intent(in) :: system
    !> Circular frequencies (rad/s), ascending, shape (n_dof); mode shapes in columns, shape
    !! (n_dof, n_dof).
    real(wp), intent(out) :: omega(:), shapes(:, :)
    !> Subject 'stiffness' if static equilibrium is unstable by flutter or divergence.
    type(status_type), intent(out) :: status
    real(wp) :: stiffness(size(omega), size(omega))

    call set_ok(status)
    stiffness = matmul(system%spread, system%gather)
    if (all(abs(stiffness - transpose(stiffness)) <= asymmetric*maxval(abs(stiffness)))) then
      call find_symmetric_modes(system%mass, stiffness, omega, shapes)
    else
      call find_modes(system%mass, stiffness, omega, shapes, status)
      if (status%failed()) return
    end if
    if (minval(omega) < -negative*maxval(abs(omega))) then
      call fail(status, status_input_error, 'stiffness', 'stiffness: has an eigenvalue ' &
                //show(minval(omega))//' < 0, rest is unstable and has no natural frequency ' &
                //'there (see characteristic_roots)')
      return
    end if
    omega = sqrt(max(omega, 0.0_wp))
  end subroutine oscillator_modes

  !> Smallest loss factor of all modes, from damping and memory: the relative width of a resonance.
  !! 0 where it is unknown, as with follower forces or modes at frequency 0.
  real(wp) function least_loss(system) result(loss)
    class(oscillator_type), intent(in) :: system
    real(wp), dimension(system%n_dof(), system%n_dof()) :: stiffness, shapes
    real(wp) :: omega(system%n_dof())
    complex(wp) :: dynamic(system%n_dof(), system%n_dof(), 1), fraction(1, system%n_memory())
    type(status_type) :: status
    integer :: r

    select type (system)
    class is (structure_type)
      loss = system%rest%least_loss()
      return
    end select
    loss = 0.0_wp
    stiffness = matmul(system%spread, system%gather)
    if (any(abs(stiffness - transpose(stiffness)) > asymmetric*maxval(abs(stiffness)))) return
    call oscillator_modes(system, omega, shapes, status)
    if (status%failed()) return
    if (.not. minval(omega) > 0.0_wp) return
    loss = huge(loss)
    do r = 1, size(omega)
      call system%retained(omega(r:r), fraction)
      call system%dynamic_stiffness(omega(r:r), omega(r:r), fraction, dynamic)
      loss = min(loss, dot_product(shapes(:, r), matmul(aimag(dynamic(:, :, 1)), shapes(:, r))) &
                 /(omega(r)**2*dot_product(shapes(:, r), matmul(system%mass, shapes(:, r)))))
    end do
    loss = max(loss, 0.0_wp)
  end function least_loss

  !> Eigenvalues of M^-1 K, ascending, and their vectors by inverse iteration.
  subroutine find_modes(mass, stiffness, squares, shapes, status)
    real(wp), intent(in) :: mass(:, :), stiffness(:, :)
    real(wp), intent(out) :: squares(:), shapes(:, :)
    type(status_type), intent(out) :: status
    real(wp), dimension(size(squares), size(squares)) :: matrix, factors
    complex(wp) :: values(size(squares))
    real(wp) :: largest
    integer :: pivots(size(squares)), i, j, n
    logical :: singular, found

    n = size(squares)
    factors = mass
    matrix = stiffness
    call factorize(n, factors, pivots, singular)
    do j = 1, n
      call solve(n, factors, pivots, matrix(:, j))
    end do
    call eigenvalues(matrix, values, found)
    largest = maxval(abs(values))
    if (.not. found .or. any(abs(aimag(values)) > complex_part*largest)) then
      call fail(status, status_input_error, 'stiffness', 'stiffness: has complex eigenvalues, ' &
                //'rest flutters: no modes')
      return
    end if
    squares = real(values)
    do j = 1, n
      i = minloc(squares(j:), 1) + j - 1
      squares([i, j]) = squares([j, i])
    end do
    do j = 1, n
      ! Shift slightly off the eigenvalue, so that the matrix is regular.
      factors = matrix
      do i = 1, n
        factors(i, i) = factors(i, i) - squares(j) - 16.0_wp*epsilon(largest)*largest
      end do
      call factorize(n, factors, pivots, singular)
      shapes(:, j) = [(1.0_wp/(1.0_wp + 0.3_wp*i), i=1, n)]
      do i = 1, 3
        call solve(n, factors, pivots, shapes(:, j))
        shapes(:, j) = shapes(:, j)/maxval(abs(shapes(:, j)))
      end do
    end do
  end subroutine find_modes

end module viscovib_oscillator_modes
