! Optimize: -O3
!> Undamped modes K r = omega^2 M r of symmetric K and positive definite M; and the
!! eigenvalues of one small symmetric matrix, without vectors.
module viscovib_symmetric_modes
  use viscovib_exact_products, only: add_products, exact_product
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: nodes_of_recurrence
  use viscovib_sorting, only: order_of
  implicit none
  private

  public :: find_symmetric_modes, symmetric_values

  integer, parameter :: max_sweeps = 40

  !> Changes whose square is rounding, and changes too large for a step; number of refinements.
  real(wp), parameter :: small = 1.0e-8_wp, large = 0.1_wp
  integer, parameter :: passes = 6
  !> Relative rounding error of products of modes with residuals.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)

contains

  !> With M = L L', the eigenvalues of L^-1 K L'^-1 by Jacobi rotations, which compute small ones
  !! to their last digits if the matrix allows it (Demmel and Veselic, SIAM J. Matrix Anal.
  !! Appl. 13 (1992) 1204).
  pure subroutine find_symmetric_modes(mass, stiffness, squares, shapes, low)
    !> Shape (n, n).
    real(wp), intent(in) :: mass(:, :), stiffness(:, :)
    !> omega^2, ascending, shape (n); modes, a column each, shape (n, n).
    real(wp), intent(out) :: squares(:), shapes(:, :)
    !> Rounding errors of the stiffness entries; absent: 0.
    real(wp), intent(in), optional :: low(:, :)
    real(wp) :: l(size(mass, 1), size(mass, 1)), a(size(mass, 1), size(mass, 1))
    integer :: order(size(mass, 1)), n, i, j, k

    n = size(mass, 1)
    l = 0.0_wp
    do j = 1, n
      l(j, j) = sqrt(mass(j, j) - sum(l(j, :j - 1)**2))
      do i = j + 1, n
        l(i, j) = (mass(i, j) - sum(l(i, :j - 1)*l(j, :j - 1)))/l(j, j)
      end do
    end do
    a = stiffness
    do k = 1, 2
      do j = 1, n
        do i = 1, n
          a(i, j) = (a(i, j) - sum(l(i, :i - 1)*a(:i - 1, j)))/l(i, i)
        end do
      end do
      a = transpose(a)
    end do
    call rotate_to_diagonal(a, shapes)
    do j = 1, n
      squares(j) = a(j, j)
      do i = n, 1, -1
        shapes(i, j) = (shapes(i, j) - sum(l(i + 1:, i)*shapes(i + 1:, j)))/l(i, i)
      end do
    end do
    call refine(mass, stiffness, squares, shapes, low)
    order = order_of(squares)
    squares = squares(order)
    shapes = shapes(:, order)
  end subroutine find_symmetric_modes

  pure subroutine rotate_to_diagonal(a, vectors)
    real(wp), intent(inout) :: a(:, :)
    real(wp), intent(out) :: vectors(:, :)
    real(wp) :: t, c, s, theta, one(size(a, 1)), other(size(a, 1))
    integer :: i, p, q, sweep
    logical :: done

    vectors = 0.0_wp
    do i = 1, size(a, 1)
      vectors(i, i) = 1.0_wp
    end do
    do sweep = 1, max_sweeps
      done = .true.
      do p = 1, size(a, 1) - 1
        do q = p + 1, size(a, 1)
          if (abs(a(p, q)) <= epsilon(1.0_wp)*sqrt(abs(a(p, p)))*sqrt(abs(a(q, q)))) cycle
          done = .false.
          theta = 0.5_wp*(a(q, q) - a(p, p))/a(p, q)
          t = sign(1.0_wp, theta)/(abs(theta) + hypot(1.0_wp, theta))
          c = 1.0_wp/hypot(1.0_wp, t)
          s = t*c
          one = c*a(:, p) - s*a(:, q)
          other = s*a(:, p) + c*a(:, q)
          one(p) = a(p, p) - t*a(p, q)
          other(q) = a(q, q) + t*a(p, q)
          one(q) = 0.0_wp
          other(p) = 0.0_wp
          a(:, p) = one
          a(p, :) = one
          a(:, q) = other
          a(q, :) = other
          one = vectors(:, p)
          other = vectors(:, q)
          vectors(:, p) = c*one - s*other
          vectors(:, q) = s*one + c*other
        end do
      end do
      if (done) exit
    end do
  end subroutine rotate_to_diagonal

  !> Refine the modes to the precision of the entries: the rotations cause rounding errors relative
  !! to the stiffest mode. With residuals w_j = K r_j - omega_j^2 M r_j in twice the precision
  !!
  !!   r_j + sum_i r_i E_ij,   E_ij = r_i^T w_j/(omega_j^2 - omega_i^2),
  !!
  !! has an error of order E^2 (Ogita and Aishima, Japan J. Indust. Appl. Math. 35 (2018) 1007).
  !! Modes too close to each other for that are separated in their common span (Rayleigh and Ritz).
  pure subroutine refine(mass, stiffness, squares, shapes, low)
    real(wp), intent(in) :: mass(:, :), stiffness(:, :)
    real(wp), intent(inout) :: squares(:), shapes(:, :)
    real(wp), intent(in), optional :: low(:, :)
    real(wp), dimension(size(squares), size(squares)) :: off, moving, change
    real(wp) :: better(size(squares)), most
    integer :: names(size(squares)), i, j, pass

    do pass = 1, passes
      do j = 1, size(squares)
        off(:, j) = residual(mass, stiffness, squares(j), shapes(:, j), low)
      end do
      off = matmul(transpose(shapes), off)
      moving = matmul(transpose(shapes), matmul(mass, shapes))
      call find_changes(squares, off, change, names)
      most = maxval(abs(change))
      do j = 1, size(squares)
        better(j) = squares(j) + (off(j, j) + sum(change(:, j)*off(:, j)))/moving(j, j)
      end do
      ! The deviation from normality is corrected half by each mode, E_ij + E_ji = -r_i^T M r_j: the
      ! formula above satisfies this only exactly, and divides by a small number for close modes.
      change = 0.5_wp*(change - transpose(change) - moving)
      do j = 1, size(squares)
        change(j, j) = change(j, j) + 0.5_wp
      end do
      shapes = shapes + matmul(shapes, change)
      do i = 1, size(squares)
        if (count(names == i) < 2) cycle
        call take_apart(pack([(j, j=1, size(names))], names == i), off, moving, squares, better, &
                        shapes)
      end do
      squares = better
      if (most < small .and. all(names == [(i, i=1, size(names))])) exit
    end do
  end subroutine refine

  !> K r - omega^2 M r.
  pure function residual(mass, stiffness, square, shape_of, low) result(left)
    real(wp), intent(in) :: mass(:, :), stiffness(:, :), square, shape_of(:)
    real(wp), intent(in), optional :: low(:, :)
    real(wp) :: left(size(shape_of)), rests(size(shape_of)), factor, error
    integer :: k

    left = 0.0_wp
    rests = 0.0_wp
    do k = 1, size(shape_of)
      call add_products(stiffness(:, k), shape_of(k), left, rests)
      call exact_product(square, shape_of(k), factor, error)
      call add_products(mass(:, k), -factor, left, rests)
      rests = rests - mass(:, k)*error
      if (present(low)) rests = rests + low(:, k)*shape_of(k)
    end do
    left = left + rests
  end function residual

  !> E, with 0 for pairs that it does not determine; modes to be separated together have one name.
  pure subroutine find_changes(squares, off, change, names)
    real(wp), intent(in) :: squares(:), off(:, :)
    real(wp), intent(out) :: change(:, :)
    integer, intent(out) :: names(:)
    real(wp) :: apart, lost
    integer :: i, j, one, other

    change = 0.0_wp
    names = [(i, i=1, size(names))]
    do j = 1, size(squares)
      do i = 1, size(squares)
        if (i == j) cycle
        apart = squares(j) - squares(i)
        if (abs(off(i, j)) < large*abs(apart)) then
          change(i, j) = off(i, j)/apart
          cycle
        end if
        lost = rounding*max(abs(squares(i)), abs(squares(j)), rounding*maxval(abs(squares)))
        if (abs(off(i, j)) > lost) then
          one = min(names(i), names(j))
          other = max(names(i), names(j))
          where (names == other) names = one
        end if
      end do
    end do
    do j = 1, size(names)
      where (names == names(j)) change(:, j) = 0.0_wp
    end do
  end subroutine find_changes

  !> The modes in the span of a group of modes (Rayleigh and Ritz).
  pure subroutine take_apart(group, off, moving, squares, better, shapes)
    integer, intent(in) :: group(:)
    !> r_i^T w_j and r_i^T M r_j of all modes, and the previous squares.
    real(wp), intent(in) :: off(:, :), moving(:, :), squares(:)
    real(wp), intent(inout) :: better(:), shapes(:, :)
    real(wp), dimension(size(group), size(group)) :: block, turn
    real(wp) :: middle
    integer :: j

    middle = sum(squares(group))/size(group)
    do j = 1, size(group)
      block(:, j) = off(group, group(j)) + moving(group, group(j))*(squares(group(j)) - middle)
    end do
    block = 0.5_wp*(block + transpose(block))
    call rotate_to_diagonal(block, turn)
    shapes(:, group) = matmul(shapes(:, group), turn)
    do j = 1, size(group)
      better(group(j)) = middle + block(j, j)
    end do
  end subroutine take_apart

  !> Ascending.
  pure subroutine symmetric_values(matrix, values)
    !> Shape (n, n); the lower triangle is read.
    real(wp), intent(in) :: matrix(:, :)
    real(wp), intent(out) :: values(:)
    real(wp) :: a(size(values), size(values)), middle, apart
    real(wp), dimension(size(values)) :: diagonal, off, weights
    integer :: n

    n = size(values)
    if (n == 1) then
      values(1) = matrix(1, 1)
    else if (n == 2) then
      middle = 0.5_wp*(matrix(1, 1) + matrix(2, 2))
      apart = hypot(0.5_wp*(matrix(1, 1) - matrix(2, 2)), matrix(2, 1))
      values(1) = middle - sign(apart, -middle)
      ! The smaller one from the product, which avoids cancellation.
      values(2) = 0.0_wp
      if (abs(values(1)) > 0.0_wp) then
        values(2) = matrix(1, 1)*(matrix(2, 2)/values(1)) - matrix(2, 1)*(matrix(2, 1)/values(1))
      end if
      if (values(1) > values(2)) values = values(2:1:-1)
    else
      a = matrix
      call to_tridiagonal(n, a, diagonal, off)
      call nodes_of_recurrence(n, diagonal, off, values, weights)
    end if
  end subroutine symmetric_values

  !> Diagonal and subdiagonal; off(i) couples diagonal(i) and diagonal(i + 1).
  pure subroutine to_tridiagonal(n, a, diagonal, off)
    integer, intent(in) :: n
    real(wp), intent(inout) :: a(n, n)
    real(wp), intent(out) :: diagonal(n), off(n)
    real(wp) :: v(n), p(n), length, unit
    integer :: j, k

    off = 0.0_wp
    do k = 1, n - 2
      v(k + 1:) = a(k + 1:, k)
      unit = maxval(abs(v(k + 1:)))
      if (.not. maxval(abs(v(k + 2:))) > 0.0_wp) then
        off(k) = v(k + 1)
        cycle
      end if
      v(k + 1:) = v(k + 1:)/unit
      length = sqrt(sum(v(k + 1:)**2))
      off(k) = -sign(length, v(k + 1))*unit
      v(k + 1) = v(k + 1) + sign(length, v(k + 1))
      v(k + 1:) = v(k + 1:)*(sqrt(2.0_wp)/sqrt(sum(v(k + 1:)**2)))
      ! A - v w' - w v' with w = A v - (v' A v/2) v in the trailing part, |v|^2 = 2.
      p(k + 1:) = 0.0_wp
      do j = k + 1, n
        p(j) = p(j) + a(j, j)*v(j) + sum(a(j + 1:, j)*v(j + 1:))
        p(j + 1:) = p(j + 1:) + a(j + 1:, j)*v(j)
      end do
      p(k + 1:) = p(k + 1:) - 0.5_wp*sum(p(k + 1:)*v(k + 1:))*v(k + 1:)
      do j = k + 1, n
        a(j:, j) = a(j:, j) - v(j:)*p(j) - p(j:)*v(j)
      end do
    end do
    off(n - 1) = a(n, n - 1)
    do k = 1, n
      diagonal(k) = a(k, k)
    end do
  end subroutine to_tridiagonal

end module viscovib_symmetric_modes
